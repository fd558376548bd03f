"""The verdict on one limit, and the record of a proof for a limit with a fraction and a confidence."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import msgspec

from sfr_loc_map.metrics.config import VerdictState
from sfr_loc_map.metrics.figures.records import Record
from sfr_loc_map.metrics.figures.row_part import RowPart
from sfr_loc_map.metrics.figures.subjects import Subject
from sfr_loc_map.metrics.score.limits import Terms, is_lower_bound, is_on_target
from sfr_loc_map.metrics.statistics.intervals import Interval


class ProofRecord(Terms, frozen=True, kw_only=True):
    """The terms of a limit with a fraction and a confidence, and the result of its proof [ECSS-E-ST-60-10C].

    `power` is null without `good`, because only a sequential test uses the power.
    """

    #: Method of the proof: `order` (order statistics), `tested normal`, `assumed normal` or `sequential`.
    method: str
    independent: float  #: Number of independent errors: sub-trajectories of the deciding drive, or drives.
    more: int | None = None
    """Additional independent errors required for a decision; null after a decision, or if no number of further errors
    like the observed ones suffices.
    """


class LimitCounts(NamedTuple):
    """Numbers of limits by the state of their verdict."""

    met: int
    missed: int
    incomplete: int  #: Met by the available data of an incomplete part.
    undecided: int  #: Not enough data, or not judged.

    @property
    def limits(self) -> int:
        """Total number of limits."""
        return sum(self)

    @property
    def text(self) -> str:
        """The counts as text."""
        text = f"{self.met} of {self.limits} limits met, {self.missed} missed, {self.undecided} without enough data"
        return f"{text}, {self.incomplete} on incomplete data" if self.incomplete else text


class Verdict(Record, frozen=True, kw_only=True):
    """The verdict on one limit of the limits file, on a shortfall, or on a finding, which has no figure."""

    id: str | None = None  #: Identifier of the requirement in the limits file.
    text: str | None = None  #: Text of the requirement in the limits file.
    name: str  #: Name of the limit in the limits file, with the prefix `target ` for a limit on the target.
    #: Index of the limited row in the table of figures, for a group of a suite in the figures of the group; null if
    #: there is no such row. A tolerance bound is the `value` of its row.
    row: int | None = None
    subject: Subject | None = None  #: Subject of the figure.
    condition: str | None = None  #: Condition of the sub-trajectories; null for figures without sub-trajectories.
    part: RowPart | None = None  #: Part of the figure.
    figure: str | None = None  #: Name of the figure.
    statistic: str | None = None  #: Column of the row; `bound` for a tolerance bound.
    limit: float  #: Upper bound (`coverage_min`, `judged`: lower bound) in the unit of the name.
    value: float | None  #: The limited number; null if it is undefined.
    low95: float | None = None  #: Lower bound of the 95 % interval of the value.
    high95: float | None = None  #: Upper bound of the 95 % interval of the value.
    margin: float | None = None  #: Distance from the value to the limit, negative if the limit is missed.
    n: int | None = None  #: Number of values of the statistic; null for a single number.
    independent: float | None = None  #: Number of independent values; null if it is undefined.
    truth_error: float | None = None  #: Change of the value that the error of the truth can cause; null if 0.
    #: Pass if `|value| <= limit` (`coverage_min`, `judged`: `>=`). With `needs_certainty`, the complete interval must
    #: be within the limit.
    state: VerdictState = msgspec.field(name="verdict")
    certain: bool | None = None  #: Whether the interval is on one side of the limit; null without an interval.
    needs_certainty: bool = False  #: Whether the limits file requires certainty.
    by_reading: dict[str, VerdictState] = {}  #: The verdict by each reading of the specification.
    proof: ProofRecord | None = None  #: Proof of a limit with a fraction and a confidence; null for other limits.

    @property
    def interval(self) -> Interval | None:
        """Both bounds of the 95 % interval, None if it is undefined."""
        return None if self.low95 is None or self.high95 is None else (self.low95, self.high95)

    @property
    def is_lower_bound(self) -> bool:
        """Whether the limit is a lower bound, by its name."""
        return is_lower_bound(self.name)

    @property
    def is_of_target(self) -> bool:
        """Whether the limit is on calls that were measured on a target."""
        return is_on_target(self.name)

    @property
    def is_within_truth_error(self) -> bool:
        """Whether the margin is within the error of the ground truth, so that the verdict is undecided."""
        return self.margin is not None and self.truth_error is not None and abs(self.margin) <= self.truth_error

    @property
    def is_met(self) -> bool:
        """Whether the value meets the limit; a value that equals the limit meets it."""
        return self.margin is not None and self.margin >= 0.0


def counts_of(verdicts: Iterable[Verdict]) -> LimitCounts:
    """Return the counts of the verdicts on limits."""
    states = [item.state for item in verdicts]
    met, missed, incomplete = map(states.count, (VerdictState.PASS, VerdictState.FAIL, VerdictState.INCOMPLETE))
    return LimitCounts(met, missed, incomplete, undecided=len(states) - met - missed - incomplete)
