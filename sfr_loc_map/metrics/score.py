"""The score: one table of figures, a table of verdicts, and a few records about how they were made.

`Score.figure` finds a row of the table: `score.figure("position", condition="distance=5")`. JSON (`sfr-score/2`) is
written and read by msgspec alone (`metrics.score_json`): every field has its own name there, what does not apply is
null or omitted. The comments at the fields are its reference (docs/reference/score.md). Numbers in brackets are
clauses of the specification. N is the start of a sub-trajectory, N+x its end.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.display import data_frame
from sfr_loc_map.errors import ConfigError
from sfr_loc_map.metrics.catalogue import ANY, KINDS, Subject, clause_of
from sfr_loc_map.metrics.config import AssociationMode, CallKind, CloudKind, Condition, Rebase, VerdictState
from sfr_loc_map.metrics.formulas import STATISTICS, Statistics
from sfr_loc_map.metrics.intervals import Interval
from sfr_loc_map.metrics.judging.limits import Rules, is_lower_bound, is_on_target
from sfr_loc_map.metrics.record import Record
from sfr_loc_map.metrics.row_part import Place, RowPart

if TYPE_CHECKING:
    import pandas
    from plotly.graph_objects import Figure as PlotlyFigure

SCHEMA = "sfr-score/2"
Values = tuple[float | None, ...]  #: One entry a row; None where a value is undefined.
Integers = tuple[int, ...]
POOLED = "pooled"  #: Part of the rows over all drives of a suite.


def column(values: NDArray[np.floating], digits: int | None = 9) -> Values:
    """Return numbers for plots, rounded (figures are not) unless digits is None; None where not finite."""
    numbers = np.asarray(values, np.float64)
    rounded = numbers if digits is None else np.round(numbers, digits)
    return tuple(number if math.isfinite(number) else None for number in rounded.tolist())


class Columns(Record, frozen=True, kw_only=True):
    """Record whose tuples are the columns of one table; an empty column is unknown."""

    def __post_init__(self) -> None:
        """Check that all known columns have one length; ValueError if they differ."""
        columns = [value for value in msgspec.structs.asdict(self).values() if isinstance(value, tuple)]
        for value in msgspec.structs.asdict(self).values():
            columns += value.values() if isinstance(value, dict) else ()
        if len({len(column) for column in columns if column}) > 1:
            raise ValueError("its columns differ in length")


# ---- the table of figures


class Numbers(Statistics, frozen=True, kw_only=True):
    """The numbers of a row: the statistics of its values and other numbers."""

    independent: float | None = None  #: How many values are independent: n over the overlap of sub-trajectories.
    low95: float | None = None  #: Lower bound of the 95 % interval of mean + 3 sigma; of a NEES, of consistent means.
    high95: float | None = None  #: Upper bound of that interval.
    value: float | None = None  #: The number of a count, fraction or peak; of a NEES the expected mean.


class Figure(Numbers, frozen=True):
    """One row of the table of figures: which figure it is, then its numbers. Undefined or not applicable is null."""

    subject: Subject  #: What the figure is about.
    figure: str  #: Name of the figure.
    unit: str  #: `m`, `deg`, `px`, `s`, `bytes`; `1` for counts and fractions.
    clause: str = ""  #: Clause of the specification that defines the figure; empty if the specification does not.
    condition: str | None = None  #: Condition that ends the sub-trajectories [4.1.1], as on the command line.
    #: Which part of the figure: the reading of the document (`pose`, `displacement`, `position`), an axis or direction
    #: (`x`, `along`), a range (`0-4 m`), a pair (`pair 0`), a kind or stage of calls, a distance (`5 m`). What was not
    #: measured on the host begins with `target` or `stated`.
    part: str | None = None

    @property
    def place(self) -> Place:
        """Where the calls of the row were measured."""
        return RowPart.of(self.part).place

    @property
    def call(self) -> CallKind | None:
        """Kind of call that the row is about, None where the row is not about calls."""
        return CallKind(self.figure) if self.figure in [*CallKind] else RowPart.of(self.part).call

    @property
    def interval(self) -> Interval | None:
        """Both bounds of the 95 % interval, None where it is undefined."""
        return None if self.low95 is None or self.high95 is None else (self.low95, self.high95)

    @property
    def is_defined(self) -> bool:
        """Whether the row has its number: the one number of its figure, else the statistics of several values."""
        if self.is_one_number:
            return self.value is not None
        return self.mean is not None and (self.n or 0) > 1

    @property
    def is_one_number(self) -> bool:
        """Whether the row has one number: a count, a fraction, a peak."""
        has_value = self.value is not None and self.mean is None
        return has_value or self.subject in (Subject.MEMORY, Subject.COMPLETENESS) or self.figure == "coverage"

    @property
    def label(self) -> str:
        """Figure, condition and part, by which a message names the row."""
        return " ".join(filter(None, (self.figure, self.condition, self.part)))

    def statistic(self, name: str) -> float | None:
        """Return the number of a column."""
        found: float | None = self.as_dict()[name]
        return found

    def as_dict(self) -> dict[str, Any]:
        """Return all columns by name."""
        return msgspec.structs.asdict(self)


COLUMNS = tuple(Figure.__struct_fields__)
NUMBERS = (*STATISTICS, "value")
"""Columns that a view shows: the statistics, then the number of what is not made of many values."""


def figure_row(
    figure: str,
    condition: str | None = None,
    part: str | None = None,
    unit: str = "",
    statistics: Statistics | None = None,
    **numbers: float | None,
) -> Figure:
    """Return the row of a figure of the catalogue, with its clause, its subject and, unless given, its unit."""
    kind = KINDS[figure]
    place = None if part is None else str(part)
    row: dict[str, Any] = {} if statistics is None else msgspec.structs.asdict(statistics)
    for name, value in numbers.items():
        row[name] = None if value is None else int(value) if name == "n" else float(value)
    return Figure(
        clause=clause_of(kind.name, place),
        subject=kind.subject,
        condition=condition,
        part=place,
        figure=kind.name,
        unit=unit or kind.unit,
        **row,
    )


def find_rows(
    figures: tuple[Figure, ...],
    figure: str = ANY,
    *,
    subject: str = ANY,
    condition: str | Condition | None = ANY,
    part: str | RowPart | None = ANY,
) -> Iterator[Figure]:
    """Yield the rows that have these values, in their order."""
    if isinstance(part, RowPart):
        part = part.text
    if isinstance(condition, Condition):
        condition = condition.setting
    elif condition is not None and condition != ANY:
        condition = Condition.parse(condition).setting
    for row in figures:
        fits = (
            figure in (ANY, row.figure),
            subject in (ANY, row.subject),
            condition in (ANY, row.condition),
            part in (ANY, row.part),
        )
        if all(fits):
            yield row


# ---- verdicts


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


# ---- how estimates were compared with the ground truth


class Association(Record, frozen=True, kw_only=True, omit_defaults=False):
    """How estimates found their ground truth, and what became of the poses."""

    matched: int  #: Frames: poses of the ground truth that have an estimate.
    estimate_poses: int  #: Estimates given.
    truth_poses: int  #: True poses given.
    images: int | None = None  #: Images of the drive; null where they are unknown.
    lost: int = 0  #: Frames at which the localiser was lost; they count like any other.
    degraded: int = 0  #: Frames whose pose was reported as degraded; they count like any other.
    exact: int = 0  #: Frames whose stamps are equal.
    near: int = 0  #: Frames whose stamps differ within the tolerance.
    interpolated: int = 0  #: Frames with interpolated ground truth.
    estimate_duplicates: int = 0  #: Estimates ignored because a later one has the same stamp.
    truth_duplicates: int = 0  #: True poses ignored because a later one has the same stamp.
    estimate_unordered: int = 0  #: Estimates that came after one with a later stamp (sorted, not ignored).
    truth_unordered: int = 0  #: True poses that came after one with a later stamp.
    largest_difference_ns: int = 0  #: Largest difference of the two stamps of a frame.
    largest_gap_ns: int = 0  #: Largest gap of the ground truth that was interpolated.
    path_length_m: float = 0.0  #: Length of the true path over the frames.
    duration_s: float | None = None  #: From the first to the last frame.
    mode: AssociationMode = AssociationMode.MATCH  #: `match` or `interpolate`.
    tolerance_s: float = 0.0  #: Stamps this close are the same.
    max_gap_s: float = 0.0  #: Longest gap of the ground truth that is interpolated.
    spacing_frames: int = 10  #: Frames from one start of a sub-trajectory to the next [4.1.1].
    #: How error from before N is removed [4.1.2]: `T_gt(N) inv(T_est(N)) T_est(N+x)` is compared with `T_gt(N+x)`
    #: (pose); displacements in DS, and changes of attitude and heading since N, are compared (displacement); or the
    #: position at N alone is subtracted (position). Where the ground truth has no attitudes, the yaw (yaw_aligned) or
    #: the complete rotation (rotation_aligned) of the estimate is fitted over the drive, then as position.
    rebase: Rebase = Rebase.POSE
    incomplete: str | None = None  #: Why the estimate does not cover the whole drive; null if it does.


class TruthRecord(Record, frozen=True, kw_only=True, omit_defaults=False):
    """What is known of the ground truth."""

    attitude: bool  #: Whether it has attitudes; without them attitude and heading errors are unknown.
    height: bool = True  #: Whether its heights are known; without them position errors are horizontal alone.
    tilt: bool = True  #: Whether its roll and pitch are known; without them attitude errors are unknown.
    sigma_m: float | None = None  #: Standard deviation of its positions along each axis; null: taken as exact.
    sigma_deg: float | None = None  #: Standard deviation of its attitudes about each axis; null: taken as exact.
    path_excess: float | None = None  #: Fraction by which its noise lengthens its path, `2 (sigma / step)^2`.
    lever_arm_m: tuple[float, ...] = ()  #: Point in RB that its positions are of; the estimate was taken there.
    yaw_deg: float | None = None  #: Yaw that was fitted: rotates the estimate.
    tilt_deg: float | None = None  #: Angle by which z was tilted with it; null where only the yaw was fitted.
    translation_m: tuple[float, ...] = ()  #: Translation that was fitted, after the rotation.

    @property
    def is_exact(self) -> bool:
        """Whether all its components are known and taken as exact."""
        is_complete = self.attitude and self.height and self.tilt
        return is_complete and self.sigma_m is None and self.sigma_deg is None


class Alignment(Record, frozen=True, kw_only=True):
    """How APE and RPE were computed."""

    align: str  #: How the estimate was aligned: `none`, `origin`, `se3` or `sim3`.
    association: str  #: How poses of estimate and ground truth were paired.
    max_difference_s: float  #: Longest difference of the stamps of a pair.
    rpe_delta: str  #: Length of a relative error: `frames=1`.
    scale: float = 1.0  #: `p -> scale R p + t` was applied to the estimate.
    quat_xyzw: tuple[float, ...] = (0.0, 0.0, 0.0, 1.0)  #: Rotation R, scalar last.
    translation_m: tuple[float, ...] = (0.0, 0.0, 0.0)  #: t.


class CloudRecord(Record, frozen=True, kw_only=True):
    """How a cloud was compared with the ground truth."""

    kind: CloudKind | None = None  #: Whether it is fused; null where the points' pixels are unknown.
    #: Whether the points' pixels are unknown, so that only distances to the nearest true points are known.
    nearest_only: bool = False
    scored_range_m: tuple[float, float]  #: Ranges [low, high) of the ground truth that count for coverage.


class CallRecords(Record, frozen=True, kw_only=True):
    """How times and memory were measured."""

    clocks: dict[str, str] = {}  #: Clock of the times by kind of call; a host time is never a time of the target.
    memory_method: str | None = None  #: How memory was measured; null if it was not.


# ---- the software under test, and what it did


class TargetRecord(Record, frozen=True, kw_only=True, forbid_unknown_fields=False):
    """What a target reports about itself (`target.json` of the harness); unknown facts are null."""

    candidate: str | None = None  #: Version of the item under test.
    board: str | None = None  #: Board.
    os: str | None = None  #: Operating system.
    clock: str | None = None  #: Clock of the times.
    clock_resolution_s: float | None = None  #: Its resolution.
    compiler: str | None = None  #: Compiler.
    flags: str | None = None  #: Its flags.
    byte_order: str | None = None  #: `big-endian` or `little-endian`.
    pointer_bits: int | None = None  #: Size of an address.


class TargetRun(Record, frozen=True, kw_only=True):
    """Where calls were measured that are not of this host [4.2.1, 4.3.1]; their rows have the part `target`."""

    name: str  #: Name of the target.
    about: TargetRecord | None = None  #: Facts reported by the board; null where it was not a run of the harness.
    matched_share: float | None = None  #: Fraction of estimates that have a call; null where calls have no stamps.
    other_run: str | None = None  #: Which run the calls are of, where it is not the estimate's.
    memory_method: str | None = None  #: How memory was measured; null if it was not.


class MethodKind(StrEnum):
    """How a method under test is reached."""

    BUILT_IN = "built-in"  #: A part of this suite.
    PEER = "peer"  #: Known to this suite, installed by the user in an interpreter of its own.
    PYTHON = "python"  #: A Python class.
    LIBRARY = "library"  #: A C library behind the ABI of `sfr_candidate.h`.
    EXTERNAL = "external"  #: A ROS node that was not started from this suite's code.


class FindingKind(StrEnum):
    """What a method did wrong in a call."""

    CRASHED = "crashed"  #: Its process ended.
    HANGING = "hanging"  #: It did not return in time and was ended.
    OUT_OF_MEMORY = "out of memory"  #: It exceeded the memory that it may have and was ended.
    LEAKING = "leaking"  #: It keeps more memory after every call.
    RAISED = "raised"  #: It raised an error or reported a failure.
    NOT_FINITE = "not finite"  #: A number of its result is NaN or infinite.
    WRONG_STAMP = "wrong stamp"  #: Its result is that of another pair.
    MISSING = "missing answer"  #: An external node did not answer a pair.
    EARLY = "early answer"  #: An external node answered a pair before its last image was published.
    LATE = "late answer"  #: An external node answered after its time to answer.
    DOUBLED = "doubled answer"  #: An external node answered a pair again.
    MISSTATED = "misstated"  #: What it states of its time or memory contradicts what was measured from outside.
    OTHER_FRAME = "another frame"  #: An answer of an external node names other frames.
    INVALID_RESULT = "invalid result"  #: Its result has another type, size or meaning than agreed.

    @property
    def fails(self) -> bool:
        """Whether no score with it can be a pass; pairs without an answer make an estimate incomplete."""
        return self not in (FindingKind.MISSING, FindingKind.LATE, FindingKind.DOUBLED, FindingKind.OTHER_FRAME)


class MethodRecord(Record, frozen=True, kw_only=True):
    """The software that made the estimate or the cloud."""

    name: str  #: Its name.
    version: str | None  #: As the method reports it; null where it does not.
    kind: MethodKind  #: How it is reached.
    sha256: str | None = None  #: Hash of the file that it was loaded from; null where it is not one file.
    isolation: str | None = None  #: What its process was kept from; null where that is unknown, or not needed.


class FindingRecord(Record, frozen=True, kw_only=True):
    """Calls of a method with one kind of fault."""

    kind: FindingKind  #: What it did wrong.
    count: int  #: Number of calls.
    first_stamp_ns: int | None  #: Stamp of the first of them.
    text: str  #: What is known of the first, in one line.

    def __str__(self) -> str:
        """Say it in one line."""
        calls = "1 call" if self.count == 1 else f"{self.count} calls, the first"
        place = "" if self.first_stamp_ns is None else f" at stamp {self.first_stamp_ns}"
        return f"{self.kind}: {calls}{place}: {self.text}"


class AnswerCounts(Record, frozen=True, kw_only=True, omit_defaults=False):
    """What became of the pairs that were published to an external node, and of what it published."""

    pairs: int = 0  #: Pairs published to it.
    answered: int = 0  #: Pairs with a usable answer of their stamp within the time to answer.
    missing: int = 0  #: Pairs without such an answer.
    early: int = 0  #: Answers that came before the last image of their pair.
    late: int = 0  #: Answers ignored because they came after their time to answer.
    doubled: int = 0  #: Answers of a stamp that had been answered.
    other_stamp: int = 0  #: Answers whose stamp is that of no pair; poses among them count by interpolation.
    other_frame: int = 0  #: Answers ignored because they name other frames.
    not_usable: int = 0  #: Answers ignored because they are invalid: not finite, no unit quaternion, no x, y, z.


class ProcessUsage(Record, frozen=True, kw_only=True):
    """What the processes of a method took, seen from outside."""

    cpu_s: float  #: Processor time of all of them, user and system, s.
    #: That of it between the calls, and beyond what all threads could do within them; null for an external node.
    cpu_outside_s: float | None = None
    peak_rss_bytes: int  #: Largest sum of their resident memory.
    processes: int  #: Largest number of them.
    threads: int | None = None  #: Largest number of their threads; null for an external node.
    method: str  #: How it was measured.


class ExternalScore(Record, frozen=True, kw_only=True):
    """How an external node behaved."""

    task: str  #: `localisation` or `mapping`.
    topic: str  #: What it published on.
    frames: str  #: Frames that its answers name: `parent` or `parent -> child`.
    answers: AnswerCounts  #: What became of pairs and answers.
    latency_s: Statistics | None  #: From publishing the last image of a pair to its answer: not a time per call.
    process: ProcessUsage | None = None  #: CPU and memory of its processes, null where they were not watched.
    ended: str = ""  #: How its process ended during the run; empty where it ran on, or was not started here.


class ConventionRecord(Record, frozen=True, kw_only=True):
    """How the poses were converted before they were scored."""

    declared: tuple[str, ...] = ()  #: Settings that the user gave, `NAME=VALUE`.
    diagnosed: str | None = None  #: Setting that the diagnosis found and the user had applied; null without.
    fitted: bool = False  #: Whether numbers of it were fitted to the ground truth, which flatters the figures.
    sentence: str | None = None  #: What the diagnosis reports as wrong; null without.


class InputFile(Record, frozen=True, kw_only=True):
    """An input of the score."""

    path: str  #: As given.
    sha256: str  #: Hash of the content.
    data_sha256: str | None = None  #: Of a ground truth the hash of its values, whatever file they were read from.
    read_from: str | None = None  #: Of a ground truth the topic, frame or file that it was read from, where known.


class Provenance(Record, frozen=True, kw_only=True):
    """What the score was made of."""

    version: str  #: Of this suite.
    commit: str | None = None  #: Commit that it was installed from, null where that is unknown.
    command: str | None = None  #: Command that makes the figures again, null where none was given.
    inputs: dict[str, InputFile] = {}  #: Files by role.
    configuration: dict[str, Any] = {}  #: Settings in force.
    host: dict[str, str] = {}  #: Machine, system and Python.
    time: str | None = None  #: When it was made, ISO 8601.


# ---- details: the series that plots are drawn from, as columns, thinned to bounded size


class CallHistogram(Record, frozen=True, kw_only=True):
    """A histogram of the times of calls with logarithmic bins."""

    edges_s: tuple[float, ...]  #: Edges of the bins, one more than counts; empty if there was no call.
    counts: Integers  #: Calls in each bin.

    def __post_init__(self) -> None:
        """Check that there is one more edge than there are bins; ValueError if not."""
        if self.counts and len(self.edges_s) != len(self.counts) + 1:
            raise ValueError(f"{len(self.counts)} counts with {len(self.edges_s)} edges: one edge more is required")


class CallSeries(Columns, frozen=True, kw_only=True):
    """The calls in order; of many the slowest of each block."""

    slowest_of: int  #: Calls of a block.
    stamp_ns: Integers  #: Stamp of the pair.
    processing_time_s: Values  #: Wall-clock time.
    peak_rss_bytes: Values  #: Peak resident memory.
    state: tuple[str, ...]  #: What the call reported.


class CallPlots(Record, frozen=True, kw_only=True):
    """What the plots of the calls of one kind are drawn from."""

    histogram: CallHistogram  #: Of the times.
    series: CallSeries  #: Times and memory by call.


class PathRows(Columns, frozen=True, kw_only=True):
    """Every n-th frame of the trajectory; metres, DS."""

    every: int  #: n.
    stamp_ns: Integers  #: Stamps.
    travelled_m: Values  #: Length of the true path up to the frame.
    truth_x_m: Values  #: True position.
    truth_y_m: Values  #: True position.
    truth_z_m: Values  #: True position.
    estimate_x_m: Values  #: Estimated position.
    estimate_y_m: Values  #: Estimated position.
    estimate_z_m: Values  #: Estimated position.
    lost: tuple[bool, ...]  #: Whether the localiser was lost.
    degraded: tuple[bool, ...] = ()  #: Whether the pose was reported as degraded.
    sigma_x_m: Values = ()  #: Sigma of x by the covariance published; empty where none was.
    sigma_y_m: Values = ()  #: Sigma of y.
    sigma_z_m: Values = ()  #: Sigma of z.


NAMED_ERRORS = {
    "position": ("x_m", "y_m", "z_m"),
    "horizontal": ("x_m", "y_m"),
    "attitude": ("attitude_deg",),
    "heading": ("heading_deg",),
    "chord": ("chord_m",),
}
"""Columns of `SubTrajectoryRows` that hold the errors of a figure; other figures are in `others`."""


class SubTrajectoryRows(Columns, frozen=True, kw_only=True):
    """Every n-th sub-trajectory of one condition."""

    condition: str  #: What ends them.
    every: int  #: n.
    start_frame: Integers  #: Number of the first frame.
    end_frame: Integers  #: Number of the last frame.
    start_stamp_ns: Integers  #: Stamp of the first frame.
    end_stamp_ns: Integers  #: Stamp of the last frame.
    x_m: Values  #: Position error, DS.
    y_m: Values  #: Position error, DS.
    z_m: Values  #: Position error, DS.
    attitude_deg: Values  #: Attitude error.
    heading_deg: Values  #: Heading error, with its sign.
    chord_m: Values  #: Straight distance, estimate less truth.
    along_m: Values  #: Position error along the true displacement.
    cross_m: Values  #: Position error across it, positive to the left.
    travelled_m: Values  #: Length of the true path from start to end.
    others: dict[str, Values] = {}  #: Errors of all other figures of sub-trajectories, by figure, in its unit.

    def errors_of(self, figure: str) -> tuple[Values, ...]:
        """Return the errors of a figure, a column for each direction; empty if they are not kept."""
        if figure in NAMED_ERRORS:
            return tuple(getattr(self, name) for name in NAMED_ERRORS[figure])
        return (self.others[figure],) if figure in self.others else ()


class ErrorRows(Record, frozen=True, kw_only=True):
    """All errors of one figure over one condition, not thinned and not rounded: tolerance bounds are made of them."""

    figure: str  #: Figure.
    condition: str  #: Condition that ends the sub-trajectories.
    errors: tuple[Values, ...]  #: A column for each direction, in the unit of the figure.


class TrajectoryDetails(Record, frozen=True, kw_only=True):
    """What the plots of the trajectory are drawn from."""

    path: PathRows | None = None  #: Frames; null in the report of a run in progress, which has them as messages.
    sub_trajectories: tuple[SubTrajectoryRows, ...]  #: One for each condition.


class PointRows(Columns, frozen=True, kw_only=True):
    """Every n-th point of the cloud that has a ground truth."""

    x_m: Values  #: Position in LM.
    y_m: Values  #: Position in LM.
    z_m: Values  #: Position in LM.
    error_m: Values  #: Distance from the truth.
    range_m: Values  #: Distance of the truth from the left optical centre.


class ErrorImage(Record, frozen=True, kw_only=True):
    """The mean point error of blocks of pixels of one pair."""

    pair: int  #: Number of the pair.
    block_px: int  #: Pixels of a block each way.
    error_0p1mm: tuple[Integers, ...]  #: Rows of blocks, -1 where there is no point.


class Triangulation(Record, frozen=True, kw_only=True):
    """The numbers of the law of triangulation, error = Z^2 d / (f b) for a disparity error d."""

    focal_px: float  #: Focal length f.
    baseline_m: float  #: Baseline b.


class MapDetails(Record, frozen=True, kw_only=True):
    """What the plots of the map are drawn from."""

    cloud: PointRows  #: Points.
    error_images: tuple[ErrorImage, ...]  #: One for each pair.
    triangulation: Triangulation  #: Of the first pair's rig.


class Details(Record, frozen=True, kw_only=True):
    """What plots are drawn from, as far as it is known."""

    calls: dict[str, CallPlots] = {}  #: Times and memory, by kind of call.
    trajectory: TrajectoryDetails | None = None  #: Trajectory.
    map: MapDetails | None = None  #: Map.


# ---- the score


def written(default: Any) -> Any:  # noqa: ANN401 - stands for the field's value, as msgspec.field does
    """Declare a field that is always written, null or empty where it is unknown."""
    return msgspec.field(default_factory=lambda: default)


class Score(Record, frozen=True, kw_only=True, tag_field="schema", tag=SCHEMA):
    """The score of a run."""

    #: Verdict over all limits; null without limits, or where nothing is judged.
    verdict: VerdictState | None = written(None)
    figures: tuple[Figure, ...] = written(())  #: The table of figures.
    #: One for each limit, in their order, after those on findings and on what is missing.
    verdicts: tuple[Verdict, ...] = written(())
    association: Association | None = written(None)  #: How estimates found their ground truth.
    truth: TruthRecord | None = written(None)  #: Properties of the ground truth of the trajectory.
    provenance: Provenance | None = written(None)  #: What the score was made of.
    alignment: Alignment | None = None  #: How APE and RPE were computed, where they were asked for.
    cloud: CloudRecord | None = None  #: How a cloud was compared with the ground truth.
    calls: CallRecords | None = None  #: How times and memory were measured on this host.
    target: TargetRun | None = None  #: Where calls were measured elsewhere.
    method: MethodRecord | None = None  #: Whose figures these are; null where the inputs do not name it.
    findings: tuple[FindingRecord, ...] = ()  #: What that method did wrong, one for each kind.
    processes: ProcessUsage | None = None  #: What the processes of the method took; null where it has none of its own.
    external: ExternalScore | None = None  #: How an external node behaved; null where there was none.
    convention: ConventionRecord | None = None  #: How the poses were converted before they were scored.
    warnings: tuple[str, ...] = ()  #: One line for each.
    contradiction: str | None = None  #: Convention mismatch of estimate and truth: no figure of them judges anything.
    incomplete: str | None = None  #: What of the expected data cannot be judged, unless a part was asked for.
    rules: Rules | None = None  #: Rules by which the verdicts follow from the figures; null where there are no limits.
    errors: tuple[ErrorRows, ...] = ()  #: All errors of the figures of the trajectory that are limited.
    details: Details | None = None  #: What plots are drawn from.

    # ---- look-up

    def rows(
        self,
        figure: str = ANY,
        *,
        subject: str = ANY,
        condition: str | Condition | None = ANY,
        part: str | RowPart | None = ANY,
    ) -> list[Figure]:
        """Return the rows of the table of figures that have these values, in their order."""
        return list(find_rows(self.figures, figure, subject=subject, condition=condition, part=part))

    def figure(
        self,
        figure: str,
        *,
        subject: str = ANY,
        condition: str | Condition | None = ANY,
        part: str | RowPart | None = ANY,
    ) -> Figure | None:
        """Return the row of a figure and a part, without a part the row that is judged; None if there is no such row.

        Of several conditions the first one counts. ConfigError, which names the parts, if none is given and all rows of
        the figure have one that is not judged.
        """
        if part != ANY:
            return next(find_rows(self.figures, figure, subject=subject, condition=condition, part=part), None)
        row = self.judged_row(figure, subject=subject, condition=condition)
        if row is None and (rows := self.rows(figure, subject=subject, condition=condition)):
            parts = ", ".join(dict.fromkeys(str(row.part) for row in rows))
            raise ConfigError(f"figure '{figure}' has no row without a part: give part=, one of {parts}")
        return row

    def judged_row(self, figure: str, *, subject: str = ANY, condition: str | Condition | None = ANY) -> Figure | None:
        """Return the row of a figure that verdicts are on, whatever the order of the rows; None without one.

        Errors of sub-trajectories are judged by one reading of the document (`association.rebase`), those of a suite
        over all drives (`pooled`). Of every other figure the row without a part is judged.
        """
        reading = self.reading
        for row in self.rows(figure, subject=subject, condition=condition):
            is_of_pieces = row.subject is Subject.TRAJECTORY and row.condition is not None
            if row.part in ((reading, POOLED) if is_of_pieces else (None,)):
                return row
        return None

    def number(
        self,
        figure: str,
        statistic: str = "value",
        *,
        subject: str = ANY,
        condition: str | Condition | None = ANY,
        part: str | RowPart | None = ANY,
    ) -> float | None:
        """Return one number of a figure, None where it is undefined or there is no such row."""
        row = self.figure(figure, subject=subject, condition=condition, part=part)
        return None if row is None else row.statistic(statistic)

    def place_of(self, row: Figure | None) -> int | None:
        """Return the place of a row of this score in its table of figures, None for no row."""
        return next((place for place, each in enumerate(self.figures) if each is row), None)

    def row_of(self, verdict: Verdict) -> Figure | None:
        """Return the row that a verdict of this score is on, None where it is on none."""
        return None if verdict.row is None else self.figures[verdict.row]

    def has(self, subject: str) -> bool:
        """Return whether there is a figure about a subject."""
        return any(row.subject == subject for row in self.figures)

    @property
    def conditions(self) -> tuple[str, ...]:
        """The conditions of sub-trajectories, in their order."""
        return tuple(dict.fromkeys(row.condition for row in self.rows("position") if row.condition is not None))

    @property
    def reading(self) -> str | None:
        """The reading of the document that is judged, None without a trajectory."""
        return None if self.association is None else str(self.association.rebase)

    @property
    def fatal_findings(self) -> tuple[FindingRecord, ...]:
        """The findings with which no score can be a pass."""
        return tuple(item for item in self.findings if item.kind.fails)

    @property
    def on_limits(self) -> tuple[Verdict, ...]:
        """The verdicts on limits, which follow those on findings and on what is missing."""
        count = 0 if self.rules is None else len(self.rules.limits)
        return self.verdicts[len(self.verdicts) - count :]

    @property
    def missed(self) -> tuple[Verdict, ...]:
        """The verdicts that are `fail`."""
        return tuple(item for item in self.verdicts if item.state is VerdictState.FAIL)

    # ---- files, tables and figures for users of Python

    @staticmethod
    def load(path: str | os.PathLike[str]) -> Score:
        """Read the JSON of a score."""
        from sfr_loc_map.metrics.score_json import load_score

        return load_score(Path(path))

    def to_json(self) -> str:
        """Return the JSON (`sfr-score/2`), the same as of `sfr score --json`."""
        from sfr_loc_map.metrics.score_json import to_json

        return to_json(self)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the JSON."""
        from sfr_loc_map.atomic import write_text

        write_text(self.to_json(), Path(path))

    def report(self, path: str | os.PathLike[str]) -> None:
        """Write the report page, the same as of `sfr score --html`."""
        from sfr_loc_map.report.page import write_page

        write_page(self, Path(path))

    def to_markdown(self) -> str:
        """Return all tables as Markdown."""
        from sfr_loc_map.report.score_tables import score_markdown

        return score_markdown(self)

    def to_pandas(self, table: str = "figures") -> pandas.DataFrame:
        """Return a pandas table: `figures`, one row per figure, or `sub_trajectories`, thinned.

        Of a condition with many sub-trajectories only every n-th is kept; the column `every` is n. `sfr score --pieces`
        writes all of them.
        """
        if table == "figures":
            return data_frame({name: [row.as_dict()[name] for row in self.figures] for name in COLUMNS})
        if table != "sub_trajectories":
            raise ConfigError(f"table is '{table}': must be figures or sub_trajectories")
        details = None if self.details is None else self.details.trajectory
        columns: dict[str, list[Any]] = {}
        for rows in () if details is None else details.sub_trajectories:
            count = len(rows.start_frame)
            for name, values in (msgspec.structs.asdict(rows) | rows.others).items():
                if name != "others":
                    of_all = name in ("condition", "every")
                    columns.setdefault(name, []).extend([values] * count if of_all else values)
        return data_frame(columns)

    def plot(self, name: str | None = None) -> PlotlyFigure:
        """Return a figure of the report as a plotly figure, which a notebook shows; by default the first."""
        from sfr_loc_map.report.plots import to_figure
        from sfr_loc_map.report.score_figures import score_figures

        plots = {plot.name: plot for _, plots in score_figures(self) for plot in plots}
        chosen = next(iter(plots), None) if name is None else name
        if chosen not in plots:
            available = ", ".join(plots) or "none"
            raise ConfigError(f"this score has no figure '{name or 'at all'}': it has {available}")
        return to_figure(plots[chosen])

    def __repr__(self) -> str:
        from sfr_loc_map.report.score_tables import row_title
        from sfr_loc_map.report.tables import UNKNOWN

        texts = [self.verdict or "no verdict"]
        for row in (self.judged_row("position"), self.judged_row("point_error")):
            if row is not None:
                total = UNKNOWN if row.mean_plus_3sigma is None else f"{row.mean_plus_3sigma:.4g} {row.unit}"
                texts.append(f"{row_title(row)} {total} (mean + 3 sigma)")
        return f"Score({', '.join(texts)})"

    def _repr_html_(self) -> str:
        from sfr_loc_map.report.score_tables import summary_tables
        from sfr_loc_map.report.tables import to_html

        return f"<b>{self.verdict or 'no verdict'}</b>" + "".join(to_html(table) for table in summary_tables(self))
