"""The record of a search: content of `search.json`, from which the page and the evidence of a report are made."""

from __future__ import annotations

import math
from dataclasses import dataclass

import msgspec

from sfr_loc_map.metrics.conditions import label_of
from sfr_loc_map.metrics.figures.catalogue import statistic_title, title_of

SCHEMA = "sfr-search/2"
LOST_RATIO = 2.0
"""Smallest ratio that is shown, and reported to the sampler, for a drive without the figure. Its ratio is unknown."""
DIGITS = 6  #: Significant digits of the value of a parameter, unless its range is narrow.
DIGITS_OF_FLOAT = 17  #: Significant digits that identify a float64.


class PointRecord(msgspec.Struct, frozen=True):
    """A point of a search."""

    ratio: float | None  #: Figure of the worst seed divided by the limit; None if a drive lacks the figure.
    point: dict[str, float]  #: Values of the parameters by name.
    jobs: list[str] = []  #: Keys of the jobs.

    @property
    def fails(self) -> bool:
        """Whether the limit is missed."""
        return badness_of(self.ratio) > 1.0


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter of the scenario, or the amount of a fault, with its range."""

    name: str  #: Dotted name of a setting, or a name for the fault.
    low: float
    high: float
    usual: float  #: Value in the scenario, or the amount at which the fault has no effect.
    fault: str = ""  #: The fault without its amount; empty for a setting.
    is_whole: bool = False  #: Whether values are integers.

    @property
    def section(self) -> str:
        """Section of the scenario that has the parameter, or `faults`."""
        return "faults" if self.fault else self.name.partition(".")[0]

    @property
    def digits(self) -> int:
        """Number of significant digits of the values: 6, and more if the range is narrow relative to its bounds."""
        largest = max(abs(self.low), abs(self.high))
        decades = math.log10(largest) - math.log10(self.high - self.low)
        return min(DIGITS + max(0, math.floor(decades)), DIGITS_OF_FLOAT)

    def rounded(self, value: float) -> float:
        """Return a value as the scenario uses it: an integer, or a number with `digits` significant digits."""
        return float(round(value)) if self.is_whole else float(f"{value:.{self.digits}g}")

    def drawn(self, value: float) -> float:
        """Return a rounded value within the range."""
        return min(max(self.rounded(value), self.low), self.high)


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
    parameters: list[Parameter]
    points: list[PointRecord]  #: Points of the search with a result, in the order of the search.
    left_out: list[LeftOutRecord] = []  #: Points whose scenario cannot be run. They do not count as misses.
    usual: PointRecord  #: The unchanged scenario.
    found: PointRecord  #: The point with the smallest margin, which may be the unchanged scenario.
    case: PointRecord  #: The reduced case: the worst point with changes removed or made smaller.
    slices: list[SliceRecord] = []
    coverage: list[CoverageRecord] = []

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


def badness_of(ratio: float | None) -> float:
    """Return the value by which ratios are compared. A drive without the figure, such as a lost drive, is the worst."""
    return math.inf if ratio is None else ratio


def ratio_text(ratio: float | None) -> str:
    """Return a ratio in words."""
    return "a drive without the figure" if ratio is None else f"{ratio:.3g} times the limit"
