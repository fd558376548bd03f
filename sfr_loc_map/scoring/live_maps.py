"""The maps of a live run, of which the worst decides the verdict."""

from __future__ import annotations

from dataclasses import replace

from msgspec.structs import replace as struct_replace

from sfr_loc_map.metrics.config import VerdictState
from sfr_loc_map.metrics.judging.judge import judged_by
from sfr_loc_map.metrics.judging.limit_scope import task_of
from sfr_loc_map.metrics.score.limits import Limits, LimitSection
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.table.results import MapResult
from sfr_loc_map.metrics.table.row_part import Scope
from sfr_loc_map.metrics.table.rows import figure_row

OF_CLOUD = (LimitSection.MAP, LimitSection.COMPLETENESS)  #: Sections with the limits on a single map.


class LiveMaps:
    """Judges each map of a run by the limits on a map, and keeps the worst map and the number of maps.

    The worst map has the worst verdict, then the most missed limits, then the largest point error.
    """

    def __init__(self, limits: Limits | None, *, partial: bool) -> None:
        """Start a run without maps, judged by the limits on a map if there are any."""
        chosen = () if limits is None else limits.limits
        chosen = tuple(each for each in chosen if each.section in OF_CLOUD and task_of(each) is Scope.MAP)
        self._limits = None if limits is None else struct_replace(limits, limits=chosen)
        self._partial = partial
        self._count = 0
        self._worst: MapResult | None = None
        self._worst_rank = (0, 0, 0.0)
        self._missed_by_worst = set[str]()
        self._missed = set[str]()

    def add(self, made: MapResult) -> None:
        """Judge a map, and keep it if it is worse than the previous maps."""
        score = judged_by(Score(figures=made.figures, cloud=made.cloud), self._limits, partial=self._partial)
        missed = {verdict.name for verdict in score.missed}
        severity = (score.verdict or VerdictState.PASS).severity
        error_m = score.number("point_error", "mean_plus_3sigma", part=None)
        rank = severity, -len(missed), -(float("inf") if error_m is None else error_m)
        if self._worst is None or rank < self._worst_rank:
            self._worst, self._worst_rank, self._missed_by_worst = made, rank, missed
        self._missed |= missed
        self._count += 1

    @property
    def result(self) -> MapResult | None:
        """The result of the worst map, with the number of maps if there are several; None without a map."""
        if self._worst is None or self._count < 2:
            return self._worst
        caveat = f"the figures of the map are those of the worst of {self._count} maps"
        if others := sorted(self._missed - self._missed_by_worst):
            caveat += f"; other maps missed the limits {', '.join(others)}"
        figures = (*self._worst.figures, figure_row("maps", value=self._count))
        return replace(self._worst, figures=figures, caveats=(*self._worst.caveats, caveat))
