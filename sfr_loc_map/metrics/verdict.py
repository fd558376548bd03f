"""The verdict on one limit, and what a limit with a share and a confidence requires."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import msgspec

from sfr_loc_map.metrics.catalogue import Subject
from sfr_loc_map.metrics.config import VerdictState
from sfr_loc_map.metrics.intervals import Interval
from sfr_loc_map.metrics.limits import is_lower_bound, is_on_target
from sfr_loc_map.metrics.records import Record


class ProofRecord(Record, frozen=True, kw_only=True):
    """What a limit with a share and a confidence requires, and what was shown [ECSS-E-ST-60-10C]."""

    prob: float  #: Share of the errors that must lie within the limit.
    confidence: float  #: Confidence with which that must be shown.
    interpretation: str  #: `temporal` (every drive), `ensemble` (of drives) or `mixed` (of all errors) [4.1.4.2].
    normal: bool = False  #: Whether the limits file declares that errors are normal.
    good: float | None = None  #: Share of failures that is acceptable, of a sequential test.
    power: float | None = None  #: Probability that drives with that share pass.
    #: `order` of the errors, `tested normal`, `assumed normal`, or `sequential`: after which drive it was decided.
    method: str
    independent: float  #: Independent errors: sub-trajectories of the drive that decides, or drives.
    more: int | None = None  #: Without a decision: how many more are needed; null if no number of errors like these is.


class LimitCounts(NamedTuple):
    """How many limits are met and missed, and how many are not decided."""

    met: int
    missed: int
    incomplete: int  #: Met by the data there is, of a part that is incomplete.
    undecided: int  #: Without enough data, or not judged.

    @property
    def limits(self) -> int:
        """Number of all limits."""
        return sum(self)

    @property
    def text(self) -> str:
        """The counts in words."""
        text = f"{self.met} of {self.limits} limits met, {self.missed} missed, {self.undecided} without enough data"
        return f"{text}, {self.incomplete} on incomplete data" if self.incomplete else text


class Verdict(Record, frozen=True, kw_only=True):
    """The verdict on one limit."""

    id: str | None = None  #: Number of the requirement, as the limits file gives it.
    text: str | None = None  #: Text of the requirement, likewise.
    name: str  #: Name of the limit as in the limits file, after `target ` for one of the target.
    #: Place of the row that is limited in the table of figures, for a group of a suite in the figures of the group;
    #: null where there is no such row. A tolerance bound is the `value` of its row.
    row: int | None = None
    subject: Subject | None = None  #: Subject of the figure.
    condition: str | None = None  #: Condition of the sub-trajectories, null outside the trajectory.
    part: str | None = None  #: Part of the figure.
    figure: str | None = None  #: Figure.
    statistic: str | None = None  #: Column of the row; `bound` for a tolerance bound.
    limit: float  #: Upper bound, of `coverage_min` the lower one, in the unit of the name.
    value: float | None  #: The number, null where it is undefined.
    low95: float | None = None  #: Lower bound of its 95 % interval.
    high95: float | None = None  #: Upper bound of its 95 % interval.
    margin: float | None = None  #: From the value to the limit in the same unit, negative where the limit is missed.
    n: int | None = None  #: Number of values it is made of, null where it is not made of many.
    independent: float | None = None  #: How many of them are independent, null where that is not defined.
    truth_error: float | None = None  #: What the error of the ground truth may change the value by; null for nothing.
    #: Pass if `|value| <= limit` (`coverage_min`: `>=`); where certainty is required, if the whole interval is within.
    state: VerdictState = msgspec.field(name="verdict")
    certain: bool | None = None  #: Whether the interval lies on one side of the limit, null where there is no interval.
    needs_certainty: bool = False  #: Whether the limits file requires certainty.
    by_reading: dict[str, VerdictState] = {}  #: The verdict by each reading of the document.
    proof: ProofRecord | None = None  #: Of a limit with a share and a confidence.

    @property
    def interval(self) -> Interval | None:
        """Both bounds of the 95 % interval, None where it is undefined."""
        return None if self.low95 is None or self.high95 is None else (self.low95, self.high95)

    @property
    def is_lower_bound(self) -> bool:
        """Whether the figure must not be below the limit, as the name of the limit says."""
        return is_lower_bound(self.name)

    @property
    def is_of_target(self) -> bool:
        """Whether the limit is on calls that were measured on a target."""
        return is_on_target(self.name)

    @property
    def is_within_truth_error(self) -> bool:
        """Whether the error of the ground truth exceeds the margin, so that nothing is decided."""
        return self.truth_error is not None and self.margin is not None and abs(self.margin) <= self.truth_error


def counts_of(verdicts: Iterable[Verdict]) -> LimitCounts:
    """Return the counts of the verdicts on limits."""
    states = [item.state for item in verdicts]
    met, missed, incomplete = map(states.count, (VerdictState.PASS, VerdictState.FAIL, VerdictState.INCOMPLETE))
    return LimitCounts(met, missed, incomplete, undecided=len(states) - met - missed - incomplete)
