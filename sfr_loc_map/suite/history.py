"""Suites over commits or dates: which is the first that is certainly worse than what was before.

Each run is compared with a baseline: the first run, later the last run that was certainly better. So a slow decline
adds up instead of hiding in small steps. The level of the test is shared by all runs and figures (Bonferroni): in a
history without a change, the probability of a false alarm is at most `LEVEL`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.metrics.comparison import Outcome
from sfr_loc_map.metrics.score import Interval
from sfr_loc_map.metrics.score_json import to_plain
from sfr_loc_map.suite.comparison import DriveRatio, log_ratios, ratio_interval
from sfr_loc_map.suite.figure_table import FigureKind, FigureName
from sfr_loc_map.suite.sign_flip import sign_flip_p, smallest_p

SCHEMA = "sfr-history/1"
LEVEL = 0.01
"""Largest probability of a false alarm in a whole history."""
MIN_RATIO = 1.01
"""Less than one per cent is no finding, however certain."""

DriveFigures = Mapping[str, Mapping[FigureName, float]]
"""Figures of each drive, by what it has in common with those of other runs."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HistoryRun:
    """One suite of a history.

    Attributes:
        name: Commit, date or folder.
        figures: Figures of its drives.
    """

    name: str
    figures: DriveFigures


@dataclass(frozen=True, slots=True, kw_only=True)
class HistoryPoint:
    """One figure of one run, compared with its baseline.

    Attributes:
        run: Name of the run.
        kind: Accuracy, time or memory.
        figure: Name with unit.
        drives: Drives in both.
        median: Median of the figure over the drives.
        baseline: Name of the run that it is compared with.
        ratio: Geometric mean over the drives of this run over the baseline.
        ci95: Its 95 % interval.
        p: Probability of such a ratio by chance, uncorrected.
        outcome: Worse or better where this is certain.
    """

    run: str
    kind: FigureKind
    figure: str
    drives: int
    median: float
    baseline: str
    ratio: float
    ci95: Interval | None
    p: float | None
    outcome: Outcome


@dataclass(frozen=True, slots=True, kw_only=True)
class History:
    """Runs in their order.

    Attributes:
        runs: Names of the runs.
        level: Level of one comparison.
        points: By figure and run, from the second run on.
        first_worse: The first run of each kind of figure that is certainly worse, by kind.
    """

    runs: tuple[str, ...]
    level: float
    points: tuple[HistoryPoint, ...]
    first_worse: Mapping[str, str]

    def to_dict(self) -> dict[str, object]:
        """Return it as JSON values."""
        return {"schema": SCHEMA, **to_plain(self)}


def find_changes(runs: Sequence[HistoryRun]) -> History:
    """Return how the figures changed over runs.

    Args:
        runs: In the order of time, at least two.

    Raises:
        MetricsError: If there are fewer than two runs.
    """
    if len(runs) < 2:
        raise MetricsError(f"a history needs two suites or more, found {len(runs)}: give several folders")
    names = sorted({name for run in runs for figures in run.figures.values() for name in figures})
    level = LEVEL / max(1, len(names) * (len(runs) - 1))
    points = [point for name in names for point in _of_figure(name, runs, level)]
    order = {run.name: number for number, run in enumerate(runs)}
    worse: dict[str, str] = {}
    for point in sorted(points, key=lambda item: order[item.run]):
        if point.outcome is Outcome.WORSE:
            worse.setdefault(point.kind.value, point.run)
    return History(runs=tuple(run.name for run in runs), level=level, points=tuple(points), first_worse=worse)


def _of_figure(name: FigureName, runs: Sequence[HistoryRun], level: float) -> list[HistoryPoint]:
    points: list[HistoryPoint] = []
    baseline = runs[0]
    for run in runs[1:]:
        pairs = [
            DriveRatio(label=key, first=baseline.figures[key][name], other=figures[name])
            for key, figures in run.figures.items()
            if name in figures and name in baseline.figures.get(key, {})
        ]
        if not pairs:
            continue
        point = _point(name, run, baseline, pairs, level)
        points.append(point)
        if point.outcome is Outcome.BETTER:
            baseline = run
    return points


def _point(
    name: FigureName, run: HistoryRun, baseline: HistoryRun, pairs: Sequence[DriveRatio], level: float
) -> HistoryPoint:
    logs = log_ratios(pairs)
    p, ratio = sign_flip_p(logs), float(np.exp(logs.mean()))
    return HistoryPoint(
        run=run.name,
        kind=name.kind,
        figure=name.name,
        drives=len(pairs),
        median=float(np.median([item.other for item in pairs])),
        baseline=baseline.name,
        ratio=ratio,
        ci95=ratio_interval(logs),
        p=p,
        outcome=_outcome(logs, p, ratio, level),
    )


def _outcome(logs: FloatArray, p: float | None, ratio: float, level: float) -> Outcome:
    if not logs.any():
        return Outcome.EQUAL
    if p is None or smallest_p(len(logs)) > level:  # even if all drives agreed, nothing could be found
        return Outcome.NOT_ENOUGH_DATA
    if p > level or 1.0 / MIN_RATIO < ratio < MIN_RATIO:
        return Outcome.NO_DIFFERENCE
    return Outcome.WORSE if ratio > 1.0 else Outcome.BETTER
