"""Scores, as `sfr.score` gives them."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Self

from sfr_loc_map.api.paths import PathLike
from sfr_loc_map.errors import ConfigError
from sfr_loc_map.io.atomic import atomic_path
from sfr_loc_map.metrics import score as base
from sfr_loc_map.metrics.score_json import to_json
from sfr_loc_map.report.page import figures_of, load_score, overall_of, write_page
from sfr_loc_map.report.plots import to_figure
from sfr_loc_map.report.score_tables import score_markdown, summary_tables
from sfr_loc_map.report.tables import UNKNOWN, to_html

if TYPE_CHECKING:
    from plotly.graph_objects import Figure


class Score(base.Score):
    """Figures and verdicts of an estimate: the fields are those of the JSON (docs/metrics.md)."""

    @classmethod
    def of(cls, score: base.Score) -> Self:
        """Return a score with what can be done with it."""
        return cls(**{item.name: getattr(score, item.name) for item in fields(base.Score)})

    @classmethod
    def load(cls, path: PathLike) -> Self:
        """Read the JSON of a score.

        Raises:
            InputError: If the file cannot be read or holds no score.
        """
        return cls.of(load_score(Path(path)))

    @property
    def verdict(self) -> str:
        """Verdict over all limits: `pass`, `fail`, `not enough data`; `no verdict` without limits."""
        return overall_of(self).state

    @property
    def verdict_text(self) -> str:
        """The same in a sentence."""
        return overall_of(self).text

    def to_json(self) -> str:
        """Return the JSON (`sfr-score/1`), the same as of `sfr score --json`."""
        return to_json(self)

    def save(self, path: PathLike) -> None:
        """Write the JSON.

        Raises:
            OutputError: If it cannot be written.
        """
        text = self.to_json()
        with atomic_path(Path(path)) as temporary:
            temporary.write_text(text, encoding="utf-8")

    def report(self, path: PathLike) -> None:
        """Write the report page, the same as of `sfr score --html`.

        Raises:
            OutputError: If it cannot be written.
        """
        write_page(self, Path(path))

    def to_markdown(self) -> str:
        """Return all tables as Markdown."""
        return score_markdown(self)

    @property
    def plots(self) -> tuple[str, ...]:
        """Names of the figures that `plot` can draw."""
        return tuple(plot.name for plot in figures_of(self))

    def plot(self, name: str | None = None) -> Figure:
        """Return a figure of the report as a plotly figure, which a notebook shows.

        Args:
            name: One of `plots`; None for the first: the trajectory from above, or the map.

        Raises:
            ConfigError: If there is no such figure.
        """
        plots = {plot.name: plot for plot in figures_of(self)}
        if not plots or (name is not None and name not in plots):
            raise ConfigError(f"this score has no figure '{name or 'at all'}': it has {', '.join(plots) or 'none'}")
        return to_figure(plots[name] if name is not None else next(iter(plots.values())))

    def __repr__(self) -> str:
        """Return verdict and first figures."""
        return f"Score({', '.join([self.verdict, *_figures(self)])})"

    def _repr_html_(self) -> str:
        return f"<b>{self.verdict}</b>" + "".join(map(to_html, summary_tables(self)))


def _figures(score: base.Score) -> list[str]:
    """Return the first figure of trajectory and map in words."""
    texts = []
    if score.trajectory is not None:
        first = score.trajectory.first
        value = first.position_m.mean_plus_3sigma
        texts.append(
            f"position {UNKNOWN if value is None else f'{value:.4g} m'} (mean + 3 sigma) over {first.condition}"
        )
    if score.map is not None and score.map.errors is not None:
        value = score.map.errors.point_error_m.mean_plus_3sigma
        texts.append(f"map points {UNKNOWN if value is None else f'{value:.4g} m'} (mean + 3 sigma)")
    return texts
