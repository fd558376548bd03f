"""The limits of requirements: which figures can be limited, and the rules that a score keeps with its verdicts.

Every name of a limit states figure, statistic and unit. Limits are upper bounds, except `coverage_min`.
`metrics.judging.limits_file` reads a limits file, and `metrics.judging.judge` makes the verdicts.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from enum import StrEnum
from typing import NamedTuple

import msgspec

from sfr_loc_map.metrics.catalogue import ALIGNED, CALLS, CATALOGUE, KINDS, MAP, FigureKind, Subject
from sfr_loc_map.metrics.config import CallKind, Condition
from sfr_loc_map.metrics.formulas import STATISTICS
from sfr_loc_map.metrics.records import Record
from sfr_loc_map.metrics.row_part import Place, RowPart
from sfr_loc_map.metrics.shortfall_kinds import SHORTFALLS
from sfr_loc_map.metrics.tolerance import CONFIDENCE, THREE_SIGMA


class LimitSection(StrEnum):
    """Section of a limits file, named by what its limits are on."""

    COMPLETENESS = "completeness"
    TRAJECTORY = "trajectory"
    MAP = "map"
    TIMING = "timing"
    MEMORY = "memory"
    TARGET = "target"


class Interpretation(StrEnum):
    """Over what the share of a requirement is taken [ECSS-E-ST-60-10C, 4.1.4.2]."""

    TEMPORAL = "temporal"
    ENSEMBLE = "ensemble"
    MIXED = "mixed"


class Terms(NamedTuple):
    """What a limit requires besides its bound."""

    prob: float = THREE_SIGMA  #: Share of the errors that lie within the limit.
    confidence: float = CONFIDENCE  #: Confidence with which that must be shown.
    interpretation: Interpretation = Interpretation.TEMPORAL
    normal: bool = False  #: Whether errors are declared to be normal, which few values cannot show.
    power: float = CONFIDENCE  #: Probability that drives with the share `good` of failures pass.
    good: float | None = None  #: Share of failures that is acceptable; with it drives are judged by a sequential test.


class Limited(NamedTuple):
    """The number that a limit is on: a row of the table of figures, and a column of it."""

    subject: Subject
    figure: str
    statistic: str
    part: RowPart | None = None  #: Part of the row; None: the row that is judged (`Score.figure`).
    is_of_worst_call: bool = False  #: Whether the row is that of the kind of call with the largest number.

    def of_target(self) -> Limited:
        """Return the same number of the calls that were measured on a target."""
        return self._replace(part=(self.part or RowPart()).at(Place.TARGET))

    @property
    def call(self) -> CallKind | None:
        """Kind of call whose time or memory is limited, None for other figures."""
        if self.subject is Subject.TIMING:
            return CallKind(self.figure)
        return None if self.part is None else self.part.call


BOUND = "bound"  #: Statistic of a limit that is judged by a tolerance bound.
MISSING = "missing_max_share"  #: Limit on how much of a drive may be missing.
COVERAGE_MIN = "coverage_min"  #: The one limit that is a lower bound.
MINIMUM_COUNT = 2  #: Default minimum number of values for a verdict.
MINIMUM_INDEPENDENT = 5.0  #: Default minimum number of independent sub-trajectories for a verdict.


def names_of(kinds: Iterable[FigureKind], statistics: Sequence[str] = STATISTICS) -> dict[str, Limited]:
    """Return the names of limits on some figures, which end in the unit: `position_mean_plus_3sigma_m`."""
    return {
        f"{kind.name}_{statistic}_{kind.unit}": Limited(kind.subject, kind.name, statistic)
        for kind in kinds
        for statistic in statistics
    }


OF_CLOUD = [kind for kind in CATALOGUE if kind.subject is Subject.MAP and not kind.is_count]
PLACES: dict[LimitSection, dict[str, Limited]] = {
    LimitSection.COMPLETENESS: {
        f"{kind.figure}_max_share": Limited(
            Subject.COMPLETENESS, kind.figure, "value", is_of_worst_call=kind.part == CALLS
        )
        for kind in SHORTFALLS
        if not KINDS[kind.figure].is_count
    },
    LimitSection.TRAJECTORY: names_of(
        [kind for kind in CATALOGUE if kind.subject is Subject.TRAJECTORY and kind.name not in ALIGNED],
        (*STATISTICS, BOUND),
    ),
    LimitSection.MAP: {
        **names_of([kind for kind in OF_CLOUD if not kind.is_one_number]),
        **{
            f"{kind.name}_{kind.unit}": Limited(kind.subject, kind.name, "value")
            for kind in OF_CLOUD
            if kind.is_one_number and kind.unit != "1"
        },
        COVERAGE_MIN: Limited(Subject.MAP, "coverage", "value"),
    },
    LimitSection.TIMING: {
        "mapping_call_s": Limited(Subject.TIMING, CallKind.MAPPING_CALL.value, "max"),
        **names_of([KINDS[kind] for kind in CallKind]),
    },
    LimitSection.MEMORY: {
        f"{call}_{kind.name}_bytes": Limited(Subject.MEMORY, kind.name, "value", RowPart(call=call))
        for call in (CallKind.LOCALISATION, CallKind.MAPPING, CallKind.MAPPING_CALL)
        for kind in CATALOGUE
        if kind.subject is Subject.MEMORY
    },
}
PLACES[LimitSection.TARGET] = {
    name: limited.of_target() for name, limited in (PLACES[LimitSection.TIMING] | PLACES[LimitSection.MEMORY]).items()
}
"""The number that each name of a limits file limits, by the sections of the file; names follow from the catalogue."""
ON_TARGET = f"{Place.TARGET} "  #: What the name of a limit on the target begins with in a verdict.
OF_MAP = [kind.figure for kind in SHORTFALLS if kind.part == MAP]
"""Figures of completeness that are about the map."""


class Limit(Record, frozen=True, kw_only=True):
    """One limit of a requirements file."""

    section: LimitSection = msgspec.field(name="part")  #: Section of the limits file.
    name: str  #: Name of the limit in the section, which names figure, statistic and unit.
    limit: float  #: Bound in the unit of the name.
    condition: str | None = None  #: Condition of the sub-trajectories, null outside the part `trajectory`.
    id: str | None = None  #: Number of the requirement.
    text: str | None = None  #: Its text.
    certain: bool = False  #: Whether a pass requires the whole 95 % interval to be within the limit.
    prob: float | None = None  #: Share of the errors that a tolerance bound is on; null for other limits.
    confidence: float | None = None  #: Confidence with which that share has to be shown.
    interpretation: Interpretation | None = None  #: Over what the share is taken.
    normal: bool | None = None  #: Whether the errors are declared to be normal.
    power: float | None = None  #: Probability with which drives with the share `good` of failures pass.
    good: float | None = None  #: Share of failures that is acceptable; with it a sequential test judges drives.

    def __post_init__(self) -> None:
        """Check that there is such a limit; ValueError if not."""
        if self.name not in PLACES[self.section]:
            raise ValueError(f"'{self.name}' is not a limit of the part '{self.section}'")
        if self.condition is not None and Condition.parse(self.condition).setting != self.condition:
            raise ValueError(f"'{self.condition}' is not spelled as in a score")

    @property
    def limited(self) -> Limited:
        """The number that is limited."""
        return PLACES[self.section][self.name]

    @property
    def terms(self) -> Terms | None:
        """What the limit on a tolerance bound requires besides; None for other limits."""
        if self.prob is None or self.confidence is None or self.interpretation is None:
            return None
        power = CONFIDENCE if self.power is None else self.power
        return Terms(self.prob, self.confidence, self.interpretation, bool(self.normal), power, self.good)

    @property
    def is_lower_bound(self) -> bool:
        """Whether the figure must not be below the limit."""
        return is_lower_bound(self.name)

    @property
    def is_on_one_call(self) -> bool:
        """Whether one call makes what is limited, so that no number of values is required."""
        return self.name in ("mapping_call_s", "mapping_call_max_s")

    @property
    def shown_name(self) -> str:
        """The name of the limit in a verdict: after `target ` for one of the target."""
        return ON_TARGET + self.name if self.section is LimitSection.TARGET else self.name


class Limits(Record, frozen=True, kw_only=True, omit_defaults=False):
    """All limits of a file, in its order; fewer values than the minimum are not enough for a verdict."""

    limits: tuple[Limit, ...] = ()  #: Limits in the order of their file.
    minimum_count: int = MINIMUM_COUNT  #: Fewer values than this are not enough data.
    #: Fewer independent sub-trajectories than this are not enough data.
    minimum_independent: float = MINIMUM_INDEPENDENT

    @property
    def conditions(self) -> list[str]:
        """Conditions that are limited, each once."""
        return list(dict.fromkeys(item.condition for item in self.limits if item.condition is not None))

    @property
    def figures_with_all_errors(self) -> frozenset[tuple[str, str]]:
        """Limited figures of the trajectory and their conditions.

        A score keeps all their errors, so that the limited statistics and tolerance bounds can be derived again.
        """
        limits = [item for item in self.limits if item.section is LimitSection.TRAJECTORY]
        pairs = ((item.limited.figure, item.condition) for item in limits)
        return frozenset((figure, condition) for figure, condition in pairs if condition is not None)

    @property
    def allow_missing(self) -> bool:
        """Whether a limit states which share of the drive may be missing."""
        return any(item.name == MISSING for item in self.limits)


class Rules(Limits, frozen=True, kw_only=True, omit_defaults=False):
    """The rules by which the verdicts follow from the table of figures."""

    partial: bool = False  #: Whether a part of what was expected is judged as if it were the whole.

    @classmethod
    def of(cls, limits: Limits | None, *, partial: bool) -> Rules | None:
        """Return limits as a score keeps them; None where there is no limit and no part was asked for."""
        if limits is None:
            return cls(partial=True) if partial else None
        return cls(
            limits=limits.limits,
            minimum_count=limits.minimum_count,
            minimum_independent=limits.minimum_independent,
            partial=partial,
        )


def is_lower_bound(limit_name: str) -> bool:
    """Return whether a limit is a lower bound: its name ends in `_min` (`coverage_min`)."""
    return limit_name.endswith("_min")


def is_on_target(shown_name: str) -> bool:
    """Return whether a limit is on calls that were measured on a target, by its name in a verdict."""
    return shown_name.startswith(ON_TARGET)


def margin_of(name: str, limit: float, value: float) -> float:
    """Return the distance from a value to the limit of this name, negative where the limit is missed."""
    return value - limit if is_lower_bound(name) else limit - abs(value)


def meets(limit: Limit, value: float) -> bool:
    """Return whether a value lies within a limit; a figure passes at its limit."""
    return value >= limit.limit if limit.is_lower_bound else abs(value) <= limit.limit
