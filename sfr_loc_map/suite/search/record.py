"""The record of a search: content of `search.json`, from which the page and the evidence of a report are made."""

from __future__ import annotations

import msgspec

from sfr_loc_map.metrics.conditions import label_of
from sfr_loc_map.metrics.figures.catalogue import statistic_title, title_of

SCHEMA = "sfr-search/2"
LOST_RATIO = 2.0
"""Smallest ratio that is shown, and reported to the sampler, for a drive without the figure. Its ratio is unknown."""


class PointRecord(msgspec.Struct, frozen=True):
    """A point of a search."""

    ratio: float | None  #: Figure of the worst seed divided by the limit; None if a drive lacks the figure.
    point: dict[str, float]  #: Values of the parameters by name.
    jobs: list[str] = []  #: Keys of the jobs.

    @property
    def fails(self) -> bool:
        """Whether the limit is missed."""
        return self.ratio is None or self.ratio > 1.0


class ParameterRecord(msgspec.Struct, frozen=True):
    """A parameter of a search with its range."""

    name: str
    low: float
    high: float
    usual: float
    fault: str = ""
    is_whole: bool = False


class LeftOutRecord(msgspec.Struct, frozen=True):
    """A point whose scenario cannot be run."""

    point: dict[str, float]
    reason: str


class SliceRecord(msgspec.Struct, frozen=True):
    """Ratios over a grid of two parameters, with all other parameters as in the reduced case."""

    first: int  #: Index of the parameter along x.
    second: int  #: Index of the parameter along y.
    x: list[float]
    y: list[float]
    ratios: list[list[float | None]]  #: One row for each y; None if the scenario cannot be run.


class CoverageRecord(msgspec.Struct, frozen=True):
    """Which cells of a combination of parameter ranges have a point; each range has three cells."""

    parameters: list[str]
    cells: int
    missing: list[list[tuple[float, float]]]  #: Parameter ranges of each cell without a point.


class SearchRecord(msgspec.Struct, frozen=True, kw_only=True, tag_field="schema", tag=SCHEMA):
    """A finished search."""

    version: str = ""
    search: str = ""  #: File of the search.
    figure: str
    statistic: str
    condition: str
    limit: float
    lost_ratio: float = LOST_RATIO  #: Ratio at which a drive without the figure is shown: at least the largest ratio.
    parameters: list[ParameterRecord]
    points: list[PointRecord]  #: Points of the search with a result, in the order of the search.
    left_out: list[LeftOutRecord] = []  #: Points whose scenario cannot be run. They do not count as misses.
    usual: PointRecord  #: The unchanged scenario.
    found: PointRecord  #: The point with the smallest margin, which may be the unchanged scenario.
    case: PointRecord  #: The reduced case: the worst point with changes removed or made smaller.
    slices: list[SliceRecord] = []
    coverage: list[CoverageRecord] = []
    correlations: list[float]  #: Rank correlation of each parameter with the ratio.

    @property
    def title(self) -> str:
        """The searched figure in words."""
        return f"{title_of(self.figure)}, {statistic_title(self.statistic)}, over {label_of(self.condition)}"

    @property
    def missed(self) -> int:
        """Number of points at which the limit is missed."""
        return sum(item.fails for item in self.points)

    @property
    def until_first_miss(self) -> int | None:
        """Number of points up to the first miss; None without a miss."""
        return next((number for number, item in enumerate(self.points, 1) if item.fails), None)


def ratio_text(ratio: float | None) -> str:
    """Return a ratio in words."""
    return "a drive without the figure" if ratio is None else f"{ratio:.3g} times the limit"
