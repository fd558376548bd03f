"""The score: what `sfr score`, `sfr replay` and the monitor node say about a run, as values.

Numbers in brackets are clauses of the specification; docs/metrics.md has the rules in full. N is the start of a
sub-trajectory, N+x its end, n the number of sub-trajectories or values. None is a figure that is undefined (too few
values) or a part that is absent. `metrics.score_json` writes and reads the JSON, in which every field stands under its
own name unless an annotation says otherwise. The comments at the fields are its reference (docs/reference/score.md).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import MISSING, Field, dataclass, field, fields
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, NamedTuple, dataclass_transform

from sfr_loc_map.metrics.config import AssociationMode, CallKind, CloudKind, Condition, Rebase, VerdictState

Interval = tuple[float, float]  #: Lower and upper bound of a 95 % interval.
Column = tuple[float | None, ...]  #: One entry a row; None where a value is undefined.
Integers = tuple[int, ...]


class Key(NamedTuple):
    """Annotation: the key of a field in JSON, where it is not the field's name."""

    name: str


class Inline(NamedTuple):
    """Annotation: the keys of a field stand in its owner's object, after a prefix; all absent: the field is None."""

    prefix: str = ""


@dataclass_transform(frozen_default=True, kw_only_default=True)
class Record:
    """Base of what is written as JSON: classes derived from it are frozen dataclasses with keywords only."""

    if TYPE_CHECKING:  # no field of it
        __dataclass_fields__: ClassVar[dict[str, Field[Any]]]

    def __init_subclass__(cls) -> None:
        dataclass(frozen=True, kw_only=True)(cls)


class Columns(Record):
    """Record whose tuples are the columns of one table, of one length; those with a default may be empty."""

    def check(self) -> None:
        """Check the lengths of what was read; ValueError if they differ."""
        columns = ((getattr(self, item.name), item.default is MISSING) for item in fields(self))
        if len({len(part) for part, needed in columns if isinstance(part, tuple) and (part or needed)}) > 1:
            raise ValueError("its columns differ in length")


# ---- what is said of many values


class Statistic(Record):
    """Mean and scatter of one error."""

    mean: float | None  #: Sum of the values over n; of a vector the norm of the mean vector [4.1.3].
    sigma: float | None  #: `sqrt(sum (e_i - mean)^2 / (n - 1))`; of a vector the norm of those of its axes [4.1.3].
    mean_plus_3sigma: float | None  #: `|mean| + 3 sigma`.


class IntervalStatistic(Statistic):
    """Mean and scatter of one error over sub-trajectories, with the interval of their sum."""

    mean_plus_3sigma_ci95: Interval | None  #: 95 % interval, see `metrics.statistics`.


class SampleStatistic(Record):
    """Mean, scatter and percentiles of a set of single values."""

    count: int  #: Number of values n.
    mean: float | None  #: `sum e_i / n`.
    sigma: float | None  #: `sqrt(sum (e_i - mean)^2 / (n - 1))` [4.1.3].
    mean_plus_3sigma: float | None  #: `mean + 3 sigma`.
    p50: float | None  #: Median, interpolated linearly between values.
    p95: float | None  #: 95th percentile, alike.


class NeesPart(Record):
    """Normalised estimation error squared of some components (Bar-Shalom, Li, Kirubarajan 2001, section 5.4)."""

    mean: float | None  #: `sum e_i^T Q_i^-1 e_i / n`, Q the covariance of the end given the start.
    expected: float  #: Number of components: the mean of an honest covariance.
    interval95: Interval | None  #: 2.5 % and 97.5 % points of chi-square with `expected n` degrees of freedom, over n.
    consistent: bool | None  #: Whether the mean lies in it.


class NeesScore(Record):
    """Whether the published covariance is honest; over sub-trajectories that share no frame."""

    count: int  #: Sub-trajectories with a usable covariance.
    not_usable: int  #: Sub-trajectories over which the covariance did not grow, so that it cannot be tested.
    from_steps: int = 0  #: Those judged by the covariances of the steps between, not by the growth of the published.
    pose: NeesPart  #: Position and attitude, 6 components.
    position: NeesPart  #: 3 components.
    attitude: NeesPart  #: 3 components.


class ErrorComponents(Record):
    """The position error by directions, m, means with their signs."""

    x_m: Statistic  #: Along x of DS.
    y_m: Statistic  #: Along y of DS.
    z_m: Statistic  #: Along z of DS.
    along_m: Statistic  #: Along the horizontal direction of the true displacement from N to N+x.
    cross_m: Statistic  #: To the left of it.
    vertical_m: Statistic  #: Along z of DS.


class ReadingScore(Record):
    """The errors of one condition by one reading of the document."""

    position_m: Statistic  #: As in `ConditionScore`.
    attitude_deg: Statistic  #: As in `ConditionScore`.
    heading_deg: Statistic  #: As in `ConditionScore`.


class Readings(Record):
    """The errors of one condition by each reading of the document; see `rebase`."""

    pose: ReadingScore  #: The whole pose at N is taken away.
    displacement: ReadingScore  #: Displacements in DS, and changes since N, are compared: the document to the letter.
    position: ReadingScore  #: The position at N alone is taken away.


class ConditionScore(Record):
    """The errors over the sub-trajectories of one condition [4.1.1, 4.1.2, 4.2.3]."""

    count: int  #: Number of sub-trajectories n.
    condition: Condition  #: What ends a sub-trajectory [4.1.1].
    spacing_frames: int  #: Frames from one start to the next.
    #: How error from before N is kept out [4.1.2]: `T_gt(N) inv(T_est(N)) T_est(N+x)` is compared with `T_gt(N+x)`
    #: (pose); displacements in DS, and changes of attitude and heading since N, are compared (displacement); or only
    #: the position offset at N is taken away (position).
    #: Where the truth has no attitudes, the yaw of the estimate is fitted to it over the drive, then as position
    #: (yaw_aligned), or its whole rotation where its z is tilted (rotation_aligned): error from before N counts.
    rebase: Rebase
    position_m: IntervalStatistic  #: Estimate less truth in DS: norms of mean vector and of sigmas [4.2.3.1].
    attitude_deg: IntervalStatistic  #: `2 atan2(|v|, |w|)` of the rotation (v, w) between both [4.2.3.2].
    heading_deg: IntervalStatistic  #: Of the RB x-axis, estimate less truth, in (-180, 180] [4.2.3.3].
    chord_m: IntervalStatistic | None = None  #: Distance from N to N+x, estimate less truth: needs no attitudes.
    overlap: float  #: Starts within one sub-trajectory on average; n / overlap of them are independent.
    nees: NeesScore | None  #: Consistency of the covariance, None where none was published.
    components: ErrorComponents  #: Position error by directions.
    readings: Readings | None = None  #: The same errors by each reading; None in scores of versions before 0.2.


class DistanceScore(Record):
    """The errors over sub-trajectories of one length, for the error against distance."""

    distance_m: float  #: Length of the sub-trajectories.
    count: int  #: Their number.
    position_m: Statistic  #: As in `ConditionScore`.
    attitude_deg: Statistic  #: As in `ConditionScore`.
    heading_deg: Statistic  #: As in `ConditionScore`.


class AssociationCounts(Record):
    """What became of the poses given."""

    estimate_poses: int = 0  #: Estimates given.
    truth_poses: int = 0  #: True poses given.
    estimate_duplicates: int = 0  #: Estimates left out because a later one has the same stamp.
    truth_duplicates: int = 0  #: The same of the truth.
    estimate_unordered: int = 0  #: Estimates that came after one with a later stamp (sorted, not left out).
    truth_unordered: int = 0  #: The same of the truth.
    late: int = 0  #: Poses that a live score of versions before 0.3 left out because they came too late.
    exact: int = 0  #: Frames whose stamps are equal.
    near: int = 0  #: Frames whose stamps differ within the tolerance.
    interpolated: int = 0  #: Frames with interpolated truth.
    lost: int = 0  #: Frames at which the localiser was lost.
    degraded: int = 0  #: Frames at which it gave a pose that it has a reason to doubt.
    largest_difference_ns: int = 0  #: Of stamps of one frame.
    largest_gap_ns: int = 0  #: Of the truth interpolated.


class AssociationScore(Record):
    """How estimates found their truth."""

    counts: Annotated[AssociationCounts, Inline()]  #: What became of the poses.
    mode: Annotated[AssociationMode, Key("truth")]  #: How it was done.
    tolerance_s: float  #: Stamps this close are the same.
    max_gap_s: float  #: Longest gap of the truth that is interpolated.


class Completeness(Record):
    """What of the drive the estimate covers; see `metrics.completeness`."""

    truth_poses: int  #: True poses given.
    images: int | None = None  #: Images of the drive; None where they are not known.
    matched: int  #: Frames: poses of the truth that have an estimate.
    missing: int  #: Images without an estimate; where images are not known, true poses in gaps between estimates.
    lost: int  #: Frames at which the localiser was lost.
    degraded: int  #: Frames at which it gave a pose that it has a reason to doubt.
    unmatched_estimates: int  #: Estimates without a truth.
    doubled_stamps: int  #: Estimates left out because a later one has the same stamp.
    judged_share: float  #: Of the images those with an estimate; else of the truth's path what lies outside of gaps.
    missing_share: float  #: The rest.
    lost_share: float | None  #: Lost frames over frames.
    degraded_share: float | None  #: Degraded frames over frames.
    unmatched_share: float | None = None  #: Estimates without a truth over all stamps of estimates.
    doubled_share: float | None = None  #: Estimates left out because a later one has the same stamp, over all given.
    longest_gap_m: float  #: Longest path without an estimate.
    longest_gap_s: float  #: Longest time without an estimate.
    incomplete: str | None = None  #: Why the estimate is none of the whole drive; None where it is.


class TruthRecord(Record):
    """What is known of a truth that has noise, or positions alone."""

    attitude: bool  #: Whether it has attitudes; without them attitude and heading errors are not known.
    sigma_m: float | None  #: Standard deviation of its positions along each axis; None: taken as exact.
    sigma_deg: float | None  #: Standard deviation of its attitudes about each axis; None: taken as exact.
    path_excess: float | None = None  #: Share by which its noise lengthens its path, `2 (sigma / step)^2`.
    lever_arm_m: tuple[float, ...] = ()  #: Point in RB that its positions are of; the estimate was taken there.
    yaw_deg: float | None = None  #: Yaw that was fitted: turns the estimate.
    tilt_deg: float | None = None  #: Angle by which z was tilted with it; None where only the yaw was fitted.
    translation_m: tuple[float, ...] = ()  #: Translation that was fitted, after the turn.


class TrajectoryScore(Record):
    """The errors of a trajectory."""

    first: Annotated[ConditionScore, Inline()]  #: Score of the first condition.
    matched: int  #: Frames: poses of the truth that have an estimate.
    estimate_poses: int  #: Estimates given.
    lost: int  #: Frames at which the localiser was lost: they count like any other.
    degraded: int = 0  #: Frames at which it gave a pose that it has a reason to doubt: they count like any other.
    path_length_m: float  #: Length of the truth's path over the frames.
    duration_s: float | None  #: From the first to the last frame.
    discarded_starts: Annotated[int, Key("starts_given_up")] = 0  #: None since every pose is kept.
    association: AssociationScore  #: How estimates found their truth.
    completeness: Completeness | None = None  #: What of the drive is covered; None in scores before 0.2.
    truth: TruthRecord | None = None  #: None of a truth with attitudes that is taken as exact.
    several: Annotated[tuple[ConditionScore, ...], Key("conditions")] = ()  #: All, where there are more than one.
    by_distance: tuple[DistanceScore, ...]  #: Error against distance.

    @property
    def conditions(self) -> tuple[ConditionScore, ...]:
        """Scores of all conditions."""
        return self.several or (self.first,)

    def of(self, condition: Condition) -> ConditionScore | None:
        """Return the score of a condition, None if it was not scored."""
        return next((item for item in self.conditions if item.condition == condition), None)


class ErrorStatistics(Record):
    """What is said of single errors e_i that are never negative."""

    rmse: float | None  #: `sqrt(sum e_i^2 / n)`.
    mean: float | None  #: `sum e_i / n`.
    median: float | None  #: Interpolated between the two in the middle.
    std: float | None  #: `sqrt(sum (e_i - mean)^2 / n)`: over n, not n - 1.
    min: float | None  #: Smallest.
    max: float | None  #: Largest.


class AlignmentTransform(Record):
    """What was applied to the estimate: `p -> scale R p + t`."""

    scale: float  #: Factor of the positions, 1 except for sim3.
    quat_xyzw: tuple[float, ...]  #: Rotation R, scalar last.
    translation_m: tuple[float, ...]  #: t.


class AlignedError(Record):
    """One error of a trajectory as other tools give it."""

    description: str  #: Metric, alignment and association in one line.
    alignment: str  #: How the estimate was aligned: `none`, `origin`, `se3` or `sim3`.
    association: str  #: How poses of estimate and truth were paired.
    max_difference_s: float  #: Longest difference of the stamps of a pair.
    delta: Condition | None = None  #: From one pose of a relative error to the other; None of an absolute error.
    count: int  #: Number of errors n.
    unit: str  #: Unit of the errors beside it: `m`.
    translation: Annotated[ErrorStatistics, Inline()]  #: Of the positions, m.
    rotation_deg: ErrorStatistics  #: Of the attitudes, deg.
    transform: AlignmentTransform | None = None  #: The alignment; None for `none`.


class AlignedErrors(Record):
    """Both."""

    ape: AlignedError  #: Absolute pose error (APE; of positions ATE): estimate against truth after the alignment.
    rpe: AlignedError  #: Relative pose error (RPE): motion of the estimate against that of the truth.


class DisparityStatistic(Record):
    """The disparity errors that the depth errors amount to, `f b / Z - f b / Z_true`, px."""

    mean: float | None  #: With its sign.
    sigma: float | None  #: With Bessel's correction.
    p50_abs: float | None  #: Median of the absolute values.
    p95_abs: float | None  #: 95th percentile of the absolute values.


class SigmaNees(Record):
    """Whether the sigma of map points is honest: squares of (error along the ray / sigma), one point of each block."""

    count: int  #: Points n.
    mean: float  #: `sum (e_i / sigma_i)^2 / n`.
    median: float  #: Of the squares: the bulk, without the gross errors.
    expected: float  #: Mean of an honest sigma.
    expected_median: float  #: Median of chi-square with one degree of freedom.
    interval95: Interval  #: 2.5 % and 97.5 % points of chi-square with n degrees of freedom, over n.


class RangeScore(Record):
    """The point errors whose true range lies in [from_m, to_m)."""

    from_m: float  #: Nearest true range.
    to_m: float  #: Farthest true range, itself not included.
    coverage: float | None  #: As in `MapScore`, of this range.
    point_error_m: Annotated[SampleStatistic, Inline()]  #: As in `PointErrorScore`.
    disparity_error_px: DisparityStatistic  #: As in `PointErrorScore`.


class PairScore(Record):
    """The points of one pair."""

    pair: int  #: Number of the pair.
    coverage: float | None  #: As in `MapScore`, of this pair.
    point_error_m: SampleStatistic  #: As in `PointErrorScore`.


class PointErrorScore(Record):
    """The errors of points against the surface that their pixels see [4.3.4]."""

    points_without_truth: int  #: Points whose pixel has no truth (sky): not counted below.
    point_error_m: SampleStatistic  #: `|truth - estimate|` of every point whose pixel has a truth [4.3.4].
    disparity_error_px: DisparityStatistic  #: The same as an error of the disparity.
    sigma_nees: SigmaNees | None  #: Consistency of the points' sigma, None where there are fewer than two.
    by_range: tuple[RangeScore, ...]  #: By range of the truth from the left optical centre.
    by_pair: tuple[PairScore, ...]  #: By pair.


class MapCompleteness(Record):
    """What of the map's pairs the cloud holds, and what of the cloud can be judged."""

    pairs: int  #: Mapping pairs of the truth.
    pairs_without_cloud: int | None = None  #: Those of which no point is in the cloud; None where pixels are not known.
    pairs_without_cloud_share: float | None = None  #: The same over all pairs.
    points_without_truth: int | None = None  #: Points whose pixel has no truth (sky); None where they are not known.
    points_without_truth_share: float | None = None  #: The same over all points.


class MapScore(Record):
    """The errors and the coverage of a cloud."""

    pairs: int  #: Mapping pairs of the truth.
    points: int  #: Points of the cloud.
    completeness: MapCompleteness | None = None  #: What is in it, and can be judged; None in scores before 0.2.
    cloud: CloudKind | None = None  #: Whether it is fused; None where the points' pixels are not known.
    #: Single pairs: of the left pixels whose truth lies in the scored range the share that has a point. Fused: the
    #: share of those true points with a point nearer than two pixel footprints, `2 Z / f`.
    coverage: float | None
    coverage_range_m: tuple[float, float]  #: Scored range [low, high).
    nearest_only: bool  #: Whether pixels are not known, so that only the nearest true points can be compared.
    errors: Annotated[PointErrorScore | None, Inline()] = None  #: Against what pixels see, where they are known.
    nearest_distance_m: SampleStatistic | None = None  #: To the nearest true point, which reads low; else.


class StageTime(SampleStatistic):
    """The times of one stage over the calls that had it, s."""

    max: float  #: Longest.


class CallScore(SampleStatistic):
    """The wall-clock times of all calls of one kind, s [4.2.1]."""

    p99: float | None  #: 99th percentile.
    max: float | None  #: Longest.
    first: float | None  #: The first call, which may load or compile.
    max_after_first: float | None  #: Longest of the others.
    clock: str  #: Clock they were measured with; a host time is never a time of the target.
    stages: Mapping[str, StageTime] = field(default_factory=dict)  #: By name, where the calls tell them.


class ByKind(Record):
    """What there is of calls by kind; None where there was none."""

    def of(self, kind: CallKind) -> Any:  # noqa: ANN401 - of the type of the fields
        """Return what there is of a kind."""
        return getattr(self, kind)


class TimingScore(ByKind):
    """The times of calls by kind [4.2.1]."""

    localisation: Annotated[CallScore | None, Key("localisation_s")] = None  #: Pairs localised.
    #: Sets of pairs mapped to one cloud each: the call that the document judges [4.3.1]; what follows are its stages.
    mapping_call: Annotated[CallScore | None, Key("mapping_call_s")] = None
    mapping: Annotated[CallScore | None, Key("mapping_s")] = None  #: Pairs mapped.
    fusion: Annotated[CallScore | None, Key("fusion_s")] = None  #: Sets fused.

    def kinds(self) -> Iterator[tuple[CallKind, CallScore]]:
        """Yield the kinds of which there were calls."""
        for kind in CallKind:
            if (calls := self.of(kind)) is not None:
                yield kind, calls


class PeakMemory(Record):
    """The memory of calls of one kind [4.2.2]; None where it was not measured."""

    peak_bytes: int | None  #: Largest high-water mark of resident memory of all calls.
    above_idle_bytes: int | None  #: The same above the idle process.
    heap_peak_bytes: int | None = None  #: Largest sum of its blocks, where a target counts them.
    stack_peak_bytes: int | None = None  #: Deepest stack, where a target measures it.


class MemoryScore(ByKind):
    """The memory of calls by kind [4.2.2]."""

    localisation: Annotated[PeakMemory | None, Inline("localisation_")] = None  #: Pairs localised.
    mapping_call: Annotated[PeakMemory | None, Inline("mapping_call_")] = None  #: Sets mapped to one cloud each.
    mapping: Annotated[PeakMemory | None, Inline("mapping_")] = None  #: Pairs mapped.
    fusion: Annotated[PeakMemory | None, Inline("fusion_")] = None  #: Sets fused.
    method: str | None = None  #: How it was measured; None if nothing was.


class TargetRecord(Record):
    """What a target says of itself (`target.json` of the harness); what it does not say is None."""

    candidate: str | None = None  #: Version of the item under test.
    board: str | None = None  #: Board.
    os: str | None = None  #: Operating system.
    clock: str | None = None  #: Clock of the times.
    clock_resolution_s: float | None = None  #: Its resolution.
    compiler: str | None = None  #: Compiler.
    flags: str | None = None  #: Its flags.
    byte_order: str | None = None  #: `big-endian` or `little-endian`.
    pointer_bits: int | None = None  #: Size of an address.
    stack_painted_bytes: int | None = None  #: Stack that was watched.


class TargetScore(Record):
    """Calls that were measured elsewhere, apart from those of this host [4.3.1, 4.3.2]."""

    name: str  #: Name of the target.
    about: TargetRecord | None = None  #: What the board says of itself; None where it was not a run of the harness.
    matched_share: float | None = None  #: Of the estimates those with a call; None where the calls have no stamps.
    other_run: str | None = None  #: Which run the calls are of, where it is not the estimate's.
    timing: TimingScore  #: Times.
    memory: MemoryScore  #: Memory, without kinds and method where it was not measured.


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
    LATE = "late answer"  #: An external node answered after its time to answer.
    DOUBLED = "doubled answer"  #: An external node answered a pair again.
    STRAY = "stray process"  #: It left a process that runs on without it: in a session of its own, or an orphan.
    OTHER_FRAME = "another frame"  #: An answer of an external node names other frames.
    INVALID_RESULT = "invalid result"  #: Its result has another type, size or meaning than agreed.

    @property
    def fails(self) -> bool:
        """Whether no score with it can be a pass; pairs without an answer make an estimate incomplete."""
        return self not in (FindingKind.MISSING, FindingKind.LATE, FindingKind.DOUBLED, FindingKind.OTHER_FRAME)


class MethodRecord(Record):
    """The software that made the estimate or the cloud."""

    name: str  #: Its name.
    version: str | None  #: As it says itself, None where it does not.
    kind: MethodKind  #: How it is reached.
    sha256: str | None = None  #: Hash of the file that it was loaded from; None where it is not one file.
    isolation: str | None = None  #: What its process was kept from; None where that is not known, or not needed.


class FindingRecord(Record):
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


class AnswerCounts(Record):
    """What became of the pairs that were published to an external node, and of what it published."""

    pairs: int = 0  #: Pairs published to it.
    answered: int = 0  #: Pairs with a usable answer of their stamp.
    missing: int = 0  #: Pairs without one.
    late: int = 0  #: Answers that came after their time to answer.
    doubled: int = 0  #: Answers of a stamp that had been answered.
    other_stamp: int = 0  #: Answers whose stamp is that of no pair; poses among them count by interpolation.
    other_frame: int = 0  #: Answers left out because they name other frames.
    not_usable: int = 0  #: Answers left out because they are none: not finite, no unit quaternion, no x, y, z.


class ProcessUsage(Record):
    """What the processes of a method took, seen from outside."""

    cpu_s: float  #: Processor time of all of them, user and system, s.
    #: That of it between the calls, and beyond what all threads could do within them; None of an external node.
    cpu_outside_s: float | None = None
    peak_rss_bytes: int  #: Largest sum of their resident memory.
    processes: int  #: Largest number of them.
    threads: int | None = None  #: Largest number of their threads; None of an external node.
    method: str  #: How it was measured.


class ExternalScore(Record):
    """How an external node behaved."""

    task: str  #: `localisation` or `mapping`.
    topic: str  #: What it published on.
    frames: str  #: Frames that its answers name: `parent` or `parent -> child`.
    answers: AnswerCounts  #: What became of pairs and answers.
    latency_s: StageTime | None  #: From publishing the last image of a pair to its answer: not a time per call.
    process: ProcessUsage | None = None  #: CPU and memory of its processes, None where they were not watched.
    ended: str = ""  #: How its process ended during the run; empty where it ran on, or was not started here.


class ConventionRecord(Record):
    """How the poses were converted before they were scored."""

    declared: tuple[str, ...] = ()  #: Settings that the user gave, `NAME=VALUE`.
    diagnosed: str | None = None  #: Setting that the diagnosis found and the user had applied; None without.
    fitted: bool = False  #: Whether numbers of it were fitted to the truth, which flatters the figures.
    sentence: str | None = None  #: What the diagnosis says is wrong; None without.


# ---- details: the series that figures are drawn from, as columns, thinned to bounded size


class CallHistogram(Record):
    """A histogram of the times of calls with logarithmic bins."""

    edges_s: tuple[float, ...]  #: Edges of the bins, one more than counts; empty if there was no call.
    counts: Integers  #: Calls in each bin.

    def __post_init__(self) -> None:
        """Check that there is one more edge than there are bins; ValueError if not."""
        if self.counts and len(self.edges_s) != len(self.counts) + 1:
            raise ValueError(f"{len(self.counts)} counts with {len(self.edges_s)} edges: one edge more is needed")


class CallSeries(Columns):
    """The calls in order; of many the slowest of each block."""

    slowest_of: int  #: Calls of a block.
    stamp_ns: Integers  #: Stamp of the pair.
    processing_time_s: Column  #: Wall-clock time.
    peak_rss_bytes: Column  #: Peak resident memory.
    state: tuple[str, ...]  #: What the call said.


class CallFigures(Record):
    """What the figures of the calls of one kind are drawn from."""

    histogram: CallHistogram  #: Of the times.
    series: CallSeries  #: Times and memory by call.


class CallDetails(ByKind):
    """The figures of calls by kind."""

    localisation: CallFigures | None = None  #: Pairs localised.
    mapping_call: CallFigures | None = None  #: Sets mapped.
    mapping: CallFigures | None = None  #: Pairs mapped.
    fusion: CallFigures | None = None  #: Sets fused.


class PathRows(Columns):
    """Every n-th frame of the trajectory; metres, DS."""

    every: int  #: n.
    stamp_ns: Integers  #: Stamps.
    travelled_m: Column  #: Length of the truth's path up to the frame.
    truth_x_m: Column  #: True position.
    truth_y_m: Column  #: True position.
    truth_z_m: Column  #: True position.
    estimate_x_m: Column  #: Estimated position.
    estimate_y_m: Column  #: Estimated position.
    estimate_z_m: Column  #: Estimated position.
    lost: tuple[bool, ...]  #: Whether the localiser was lost.
    degraded: tuple[bool, ...] = ()  #: Whether it had a reason to doubt the pose; empty in scores that do not know.
    sigma_x_m: Column = ()  #: Sigma of x by the covariance published; empty where none was.
    sigma_y_m: Column = ()  #: Sigma of y.
    sigma_z_m: Column = ()  #: Sigma of z.


class SubTrajectoryRows(Columns):
    """Every n-th sub-trajectory of one condition."""

    condition: Condition  #: What ends them.
    every: int  #: n.
    start_frame: Integers  #: Number of the first frame.
    end_frame: Integers  #: Number of the last frame.
    start_stamp_ns: Integers  #: Stamp of the first frame.
    end_stamp_ns: Integers  #: Stamp of the last frame.
    x_m: Column  #: Position error, DS.
    y_m: Column  #: Position error, DS.
    z_m: Column  #: Position error, DS.
    attitude_deg: Column  #: Attitude error.
    heading_deg: Column  #: Heading error, with its sign.
    chord_m: Column = ()  #: Straight distance, estimate less truth.
    along_m: Column  #: Position error along the true displacement.
    cross_m: Column  #: Position error to the left of it.
    vertical_m: Column  #: Position error along z of DS.
    travelled_m: Column  #: Length of the truth's path from start to end.


class TrajectoryDetails(Record):
    """What the figures of the trajectory are drawn from."""

    path: PathRows  #: Frames.
    sub_trajectories: tuple[SubTrajectoryRows, ...]  #: One for each condition.


class PointRows(Columns):
    """Every n-th point of the cloud that has a truth."""

    x_m: Column  #: Position in LM.
    y_m: Column  #: Position in LM.
    z_m: Column  #: Position in LM.
    error_m: Column  #: Distance from the truth.
    range_m: Column  #: Distance of the truth from the left optical centre.


class ErrorImage(Record):
    """The mean point error of blocks of pixels of one pair."""

    pair: int  #: Number of the pair.
    block_px: int  #: Pixels of a block each way.
    error: Annotated[tuple[Integers, ...], Key("error_0p1mm")]  #: Rows of blocks, -1 where there is no point.


class Triangulation(Record):
    """The numbers of the law of triangulation, error = Z^2 d / (f b) for a disparity error d."""

    focal_px: float  #: Focal length f.
    baseline_m: float  #: Baseline b.


class MapDetails(Record):
    """What the figures of the map are drawn from."""

    cloud: PointRows  #: Points.
    error_images: tuple[ErrorImage, ...]  #: One for each pair.
    triangulation: Triangulation  #: Of the first pair's rig.


class Details(Record):
    """What figures are drawn from, as far as it is there."""

    calls: CallDetails | None = None  #: Times and memory.
    trajectory: TrajectoryDetails | None = None  #: Trajectory.
    map: MapDetails | None = None  #: Map.


class Verdict(Record):
    """The verdict on one limit."""

    metric: str  #: Name of the figure as in the limits file, after `target ` for one of the target.
    id: str | None = None  #: Number of the requirement, as the limits file gives it.
    text: str | None = None  #: Its text, likewise.
    limit: float  #: Upper bound, of `coverage_min` the lower one, in the unit of the name.
    value: float | None  #: The figure, None where it is undefined.
    ci95: Interval | None  #: Its 95 % interval, None where it has none.
    margin: float | None = None  #: From the figure to the limit in the same unit, negative where it is missed.
    condition: Condition | None = None  #: Condition of the sub-trajectories, None outside the trajectory.
    count: int | None  #: Number of values the figure is made of, None where it is not made of many.
    #: Pass if `|value| <= limit` (`coverage_min`: `>=`); where certainty is needed, if the whole interval is within.
    state: Annotated[VerdictState, Key("verdict")]
    certain: bool | None  #: Whether the interval lies on one side of the limit, None where there is no interval.
    needs_certainty: bool = False  #: Whether the limits file asks for it.
    by_reading: Mapping[str, VerdictState] = field(default_factory=dict)  #: By each reading of the document.


class InputFile(Record):
    """An input of the score."""

    path: str  #: As given.
    sha256: str  #: Hash of the content.
    data_sha256: str | None = None  #: Of a truth the hash of its values, whatever file they were read from.
    read_from: str | None = None  #: Of a truth the topic, frame or file that it was read from, where it is said.


class Provenance(Record):
    """What the score was made of."""

    version: str  #: Of this suite.
    commit: str | None = None  #: Commit that it was installed from, None where that is not known.
    command: str | None = None  #: Command that makes the figures again, None where none was given.
    inputs: Mapping[str, InputFile] = field(default_factory=dict)  #: Files by role.
    configuration: Mapping[str, object] = field(default_factory=dict)  #: Settings in force.
    host: Mapping[str, str] = field(default_factory=dict)  #: Machine, system and Python.
    time: str | None = None  #: When it was made, ISO 8601.


class Score(Record):
    """The whole score; parts that are absent are None or empty."""

    method: MethodRecord | None = None  #: Whose figures these are; None where nobody has said so.
    findings: tuple[FindingRecord, ...] = ()  #: What that method did wrong, one for each kind.
    external: ExternalScore | None = None  #: How an external node behaved; None where there was none.
    convention: ConventionRecord | None = None  #: How the poses were converted before they were scored.
    trajectory: TrajectoryScore | None = None  #: Errors of the trajectory.
    aligned: Annotated[AlignedErrors | None, Inline()] = None  #: `ape` and `rpe`, where an alignment was asked for.
    map: MapScore | None = None  #: Errors of the map.
    timing: TimingScore | None = None  #: Times of the calls on this host.
    memory: MemoryScore | None = None  #: Memory of the calls on this host.
    processes: ProcessUsage | None = None  #: What the processes of the method took; None where it had none of its own.
    target: TargetScore | None = None  #: Calls that were measured elsewhere.
    verdicts: tuple[
        Verdict, ...
    ]  #: One for each limit, in their order, after those on findings and on what is missing.
    warnings: tuple[str, ...] = ()  #: One line for each.
    contradiction: str | None = None  #: Convention mismatch of estimate and truth: no figure of them judges anything.
    incomplete: str | None = None  #: Why the estimate is none of the whole drive, unless a part was asked for.
    provenance: Provenance | None = None  #: What it was made of.
    details: Details | None = None  #: What figures are drawn from.

    @property
    def failures(self) -> tuple[FindingRecord, ...]:
        """The findings with which no score can be a pass."""
        return tuple(item for item in self.findings if item.kind.fails)

    @property
    def failed(self) -> tuple[Verdict, ...]:
        """The verdicts that are `fail`."""
        return tuple(item for item in self.verdicts if item.state is VerdictState.FAIL)
