"""The limits of requirements: the numbers that can be limited, and the limits that a score stores with its verdicts.

The name of a limit states figure, statistic and unit. Limits are upper bounds, except `coverage_min` and the required
fraction `judged`. `metrics.judging.limits_file` reads a limits file, and `metrics.judging.judge` makes the verdicts.

`LIMITED_NUMBERS` contains the number of each name. To add a limit:

- on a figure of the trajectory, the map or calls: add the figure to `metrics.figures.catalogue`. Its names follow.
- on completeness: add the shortfall to `metrics.completeness.shortfall_kinds`. Its name `FIGURE_max_share` follows.
- on any other number: add its name to `LIMITED_NUMBERS`. A lower bound has a name that ends in `_min`.

The template of a limits file (`metrics.judging.limits_template`), the check of stored scores, and the reports then
include the limit. A new section of the limits file also requires a member of `LimitSection`, its meaning in the
template, and the scope that must be complete for a pass (`metrics.judging.limited.required_scope`).
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from enum import StrEnum
from typing import Any, NamedTuple

import msgspec

from sfr_loc_map.metrics.completeness.shortfall_kinds import SHORTFALLS
from sfr_loc_map.metrics.conditions import is_written_condition
from sfr_loc_map.metrics.config import CallKind
from sfr_loc_map.metrics.figures.catalogue import ALIGNED, CATALOGUE, JUDGED, KINDS, TOTAL, Content, FigureKind
from sfr_loc_map.metrics.figures.records import Record
from sfr_loc_map.metrics.figures.row_part import Place, RowPart, calls_part
from sfr_loc_map.metrics.figures.subjects import LimitSection, Scope, Subject
from sfr_loc_map.metrics.formulas import STATISTICS
from sfr_loc_map.metrics.statistics.tolerance import CONFIDENCE, THREE_SIGMA


class Population(StrEnum):
    """Population of the fraction of a requirement [ECSS-E-ST-60-10C, 4.1.4.2]; see `metrics.judging.proof`."""

    TEMPORAL = "temporal"
    ENSEMBLE = "ensemble"
    MIXED = "mixed"


class Terms(Record, frozen=True, kw_only=True):
    """Terms of a limit that is judged by a tolerance bound [ECSS-E-ST-60-10C]."""

    prob: float  #: Fraction of the errors that must be within the limit.
    confidence: float  #: Confidence with which this fraction must be proved.
    #: Population of the fraction [4.1.4.2]: `temporal` (every drive), `ensemble` (the largest error of each drive) or
    #: `mixed` (one drawn sub-trajectory of each drive).
    interpretation: Population
    normal: bool = False  #: Whether the limits file declares that errors are normal.
    good: float | None = None  #: Acceptable fraction of failures; if given, a sequential test judges the drives.
    #: Probability of a pass if the fraction `good` of the drives fails; null for the default.
    power: float | None = None


DEFAULT_TERMS = Terms(prob=THREE_SIGMA, confidence=CONFIDENCE, interpretation=Population.TEMPORAL, power=CONFIDENCE)
"""Terms of a tolerance bound whose entry in a limits file states none."""


def fault_of_terms(given: Mapping[str, Any]) -> str | None:
    """Return the first fault of terms that are given by the names of `Terms`, None if they are valid."""
    for name in ("prob", "confidence", "power"):
        value = given.get(name, 0.5)
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0.5 <= value < 1.0:
            return f"'{name}' is {value!r}: a number from 0.5 to below 1 is required, 0.95 for 95 %"
    good = given.get("good", 0.0)
    most = 1.0 - float(given.get("prob", THREE_SIGMA))
    if isinstance(good, bool) or not isinstance(good, (int, float)) or not 0.0 <= good < most:
        return f"'good' is {good!r}: a fraction of failures from 0 to below 1 - prob = {most:g} is required"
    if "normal" in given and not isinstance(given["normal"], bool):
        return f"'normal' is {given['normal']!r}: true or false is required"
    word = given.get("interpretation", Population.TEMPORAL)
    if word not in [str(kind) for kind in Population]:
        return f"'interpretation' is {word!r}: one of {', '.join(Population)} is required"
    if "good" in given and word == Population.TEMPORAL:
        return "'good' is a fraction of drives: the interpretation ensemble or mixed is required"
    return None


def fault_of_bound(figure: str, bound: object) -> str | None:
    """Return why a value cannot be the bound of a limit on a figure, None if it is valid."""
    if isinstance(bound, int) and bound > sys.float_info.max:
        return f"is an integer above {sys.float_info.max:g}: a smaller number is required, in the unit of its name"
    if isinstance(bound, bool) or not isinstance(bound, int | float) or not 0 <= bound < math.inf:
        return f"is {bound!r}: a number >= 0 is required, in the unit of its name"
    if KINDS[figure].unit == "1" and bound > 1:
        return f"is {bound!r}: a fraction from 0 to 1 is required, 0.05 for 5 %"
    return None


class LimitedNumber(NamedTuple):
    """The number that a limit is on: a row and a column of the table of figures."""

    subject: Subject
    figure: str
    statistic: str  #: Column; `bound` for the tolerance bound of all errors.
    part: RowPart | None = None  #: Part of the row; None selects the judged row (`Score.judged_row`).
    is_of_worst_call: bool = False  #: Whether the row with the largest value over the kinds of calls is limited.

    def of_target(self) -> LimitedNumber:
        """Return this number for the calls that were measured on a target."""
        return self._replace(part=(self.part or RowPart("")).at(Place.TARGET))

    @property
    def call(self) -> CallKind | None:
        """Kind of call whose time or memory is limited, None for other figures."""
        if self.subject is Subject.TIMING:
            return CallKind(self.figure)
        return None if self.part is None else self.part.call


BOUND = "bound"  #: Statistic of a limit that is judged by a tolerance bound.
CERTAIN_BOUND = "'certain' is not accepted: a tolerance bound is judged with its 'confidence'"
COVERAGE_MIN = "coverage_min"  #: The only lower bound in a limits file.
COUNT_FOR_VERDICT = 2  #: Default minimum number of values for a verdict.
INDEPENDENT_FOR_VERDICT = 5.0
"""Default minimum number of independent sub-trajectories for a verdict. Chosen by hand
(docs/decisions/0009-verdicts.md, "Thresholds")."""


def names_of(kinds: Iterable[FigureKind], statistics: Sequence[str] = STATISTICS) -> dict[str, LimitedNumber]:
    """Return the limited numbers of figures by the name of the limit, such as `position_mean_plus_3sigma_m`."""
    return {
        f"{kind.name}_{statistic}_{kind.unit}": LimitedNumber(kind.subject, kind.name, statistic)
        for kind in kinds
        for statistic in statistics
    }


TRAJECTORY_FIGURES = [kind for kind in CATALOGUE if kind.subject is Subject.TRAJECTORY and kind.name not in ALIGNED]
MAP_FIGURES = [kind for kind in CATALOGUE if kind.subject is Subject.MAP]
TIMES = {
    # short name of mapping_call_max_s, because the requirement is on every mapping call
    "mapping_call_s": LimitedNumber(Subject.TIMING, CallKind.MAPPING_CALL.value, "max"),
    **names_of([KINDS[kind] for kind in CallKind]),
}
PEAKS = {
    f"{call}_{kind.name}_bytes": LimitedNumber(Subject.MEMORY, kind.name, "value", calls_part("", call))
    for call in (CallKind.LOCALISATION, CallKind.MAPPING, CallKind.MAPPING_CALL)
    for kind in CATALOGUE
    if kind.subject is Subject.MEMORY
}
LIMITED_NUMBERS: dict[LimitSection, dict[str, LimitedNumber]] = {
    LimitSection.COMPLETENESS: {
        kind.limit_name: LimitedNumber(
            Subject.COMPLETENESS, kind.figure, "value", is_of_worst_call=kind.scope is Scope.CALLS
        )
        for kind in SHORTFALLS
        if kind.limit_name is not None
    },
    LimitSection.TRAJECTORY: names_of(TRAJECTORY_FIGURES, (*STATISTICS, BOUND)),
    LimitSection.MAP: {
        **names_of([kind for kind in MAP_FIGURES if kind.content is Content.STATISTICS]),
        **{
            f"{kind.name}_{kind.unit}": LimitedNumber(kind.subject, kind.name, "value")
            for kind in MAP_FIGURES
            if kind.content is Content.NUMBER
        },
        COVERAGE_MIN: LimitedNumber(Subject.MAP, "coverage", "value"),
    },
    LimitSection.TIMING: TIMES,
    LimitSection.MEMORY: PEAKS,
    LimitSection.TARGET: {name: limited.of_target() for name, limited in (TIMES | PEAKS).items()},
}
"""The limited number of each name of a limits file, by section."""
ON_TARGET = f"{Place.TARGET} "  #: Prefix of the name of a limit on the target in a verdict.
OF_MAP = [kind.figure for kind in SHORTFALLS if kind.scope is Scope.MAP]
"""Figures of completeness that are about the map."""


class Limit(Record, frozen=True, kw_only=True):
    """One limit of a limits file."""

    section: LimitSection = msgspec.field(name="part")  #: Section of the limits file.
    name: str  #: Name of the limit in the section, which states figure, statistic and unit.
    limit: float  #: Bound in the unit of the name.
    condition: str | None = None  #: Condition of the sub-trajectories; null outside the section `trajectory`.
    id: str | None = None  #: Identifier of the requirement.
    text: str | None = None  #: Text of the requirement.
    certain: bool = False  #: Whether a pass requires the complete 95 % interval to be within the limit.
    # the terms of a tolerance bound (`Terms`), which the file has beside the other keys; null for other limits
    prob: float | None = None  #: Fraction of the errors that must be within the limit.
    confidence: float | None = None  #: Confidence with which this fraction must be proved.
    interpretation: Population | None = None  #: Population of this fraction.
    normal: bool | None = None  #: Whether the errors are declared to be normal.
    power: float | None = None  #: Probability of a pass if the fraction `good` of the drives fails.
    good: float | None = None  #: Acceptable fraction of failures; if given, a sequential test judges the drives.

    def __post_init__(self) -> None:
        """Check name, bound, condition and terms, which may come from a stored score; ValueError if invalid."""
        if self.name not in LIMITED_NUMBERS[self.section]:
            raise ValueError(f"'{self.name}' is not a limit of the section '{self.section}'")
        if (fault := fault_of_bound(self.limited.figure, self.limit)) is not None:
            raise ValueError(f"'{self.name}' {fault}")
        if self.condition is not None and not is_written_condition(self.condition):
            raise ValueError(f"'{self.condition}' is not a condition as scores write it, such as distance=5")
        is_of_trajectory = self.section is LimitSection.TRAJECTORY
        if is_of_trajectory and self.condition is None:
            raise ValueError(f"'{self.name}' of the section '{self.section}' has no condition: one is required")
        if not is_of_trajectory and self.condition is not None:
            raise ValueError(
                f"'{self.name}' of the section '{self.section}' has the condition '{self.condition}': only limits of "
                f"the section '{LimitSection.TRAJECTORY}' may have one"
            )
        given = self.given_terms
        is_bound = self.limited.statistic == BOUND
        terms = "prob, confidence and interpretation"
        if is_bound and not {"prob", "confidence", "interpretation"} <= given.keys():
            raise ValueError(f"'{self.name}': the limit requires {terms}")
        if given and not is_bound:
            raise ValueError(f"'{self.name}': the limit does not accept {terms}; only a tolerance bound has them")
        if (fault := fault_of_terms(given)) is not None:
            raise ValueError(f"'{self.name}': {fault}")
        if is_bound and self.certain:
            raise ValueError(f"'{self.name}': {CERTAIN_BOUND}")

    @property
    def limited(self) -> LimitedNumber:
        """The number that is limited."""
        return LIMITED_NUMBERS[self.section][self.name]

    @property
    def given_terms(self) -> dict[str, Any]:
        """The terms that are not null, by name."""
        return {name: value for name in Terms.__struct_fields__ if (value := getattr(self, name)) is not None}

    @property
    def terms(self) -> Terms | None:
        """The terms of a limit on a tolerance bound; None for other limits."""
        return Terms(**self.given_terms) if self.given_terms else None

    @property
    def is_lower_bound(self) -> bool:
        """Whether the limit is a lower bound."""
        return is_lower_bound(self.name)

    @property
    def is_on_one_call(self) -> bool:
        """Whether a single call is sufficient, so no minimum number of values is required."""
        return self.name in ("mapping_call_s", "mapping_call_max_s")

    @property
    def can_be_certain(self) -> bool:
        """Whether the limited number can be certain: it has a 95 % interval, or is a fraction without uncertainty."""
        if self.section is LimitSection.COMPLETENESS:
            return True
        return self.section is LimitSection.TRAJECTORY and self.limited.statistic == TOTAL

    @property
    def shown_name(self) -> str:
        """The name of the limit in a verdict, with the prefix `target ` for a limit on the target."""
        return ON_TARGET + self.name if self.section is LimitSection.TARGET else self.name


class Limits(Record, frozen=True, kw_only=True, omit_defaults=False):
    """The rules of judgement: the limits of a file, and what a verdict requires besides."""

    limits: tuple[Limit, ...] = ()  #: Limits in the order of the file.
    minimum_count: int = COUNT_FOR_VERDICT  #: Minimum number of values for a verdict.
    #: Minimum number of independent sub-trajectories for a verdict.
    minimum_independent: float = INDEPENDENT_FOR_VERDICT
    data_set_sha256: tuple[str, ...] = ()  #: Hashes of the inputs that the limits accept; empty for any data set.
    #: Whether missing data are accepted (`--partial`); wrong data and shortfalls by limit are not.
    partial: bool = False

    def has_enough_values(self, count: int | None) -> bool:
        """Return whether a number of values suffices for a verdict. None, for a figure that is one number, suffices."""
        return count is None or count >= self.minimum_count

    def has_enough_independent(self, independent: float | None) -> bool:
        """Return whether a number of independent sub-trajectories suffices for a verdict. None (undefined) suffices."""
        return independent is None or independent >= self.minimum_independent

    @property
    def conditions(self) -> list[str]:
        """Limited conditions, each once."""
        return list(dict.fromkeys(item.condition for item in self.limits if item.condition is not None))

    @property
    def bounded_figures(self) -> frozenset[tuple[str, str]]:
        """Figures and conditions with a limited tolerance bound.

        A score contains all their errors, from which the bounds are derived again.
        """
        pairs = ((item.limited.figure, item.condition) for item in self.limits if item.terms is not None)
        return frozenset((figure, condition) for figure, condition in pairs if condition is not None)


def is_lower_bound(limit_name: str) -> bool:
    """Return whether a limit is a lower bound, by its name: `coverage_min`, and the required fraction `judged`."""
    return limit_name.endswith("_min") or limit_name == JUDGED


def is_on_target(shown_name: str) -> bool:
    """Return whether a limit, by its name in a verdict, is on calls that were measured on a target."""
    return shown_name.startswith(ON_TARGET)


def margin_of(name: str, limit: float, value: float) -> float:
    """Return the margin of a value to the limit of this name, negative if the limit is missed."""
    return value - limit if is_lower_bound(name) else limit - abs(value)


def meets(limit: Limit, value: float) -> bool:
    """Return whether a value is within a limit; a value that equals the limit is within it."""
    return value >= limit.limit if limit.is_lower_bound else abs(value) <= limit.limit
