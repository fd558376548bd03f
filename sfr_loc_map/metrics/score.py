"""The score: what `sfr score`, `sfr replay` and the monitor node say about a run, as values.

Numbers in brackets are clauses of the specification; docs/metrics.md has the rules in full. N is the start of a
sub-trajectory, N+x its end, n the number of sub-trajectories or values. None is a figure that is undefined (too few
values); a part that is absent is None as well, or empty. `metrics.score_json` writes and reads the JSON, in which every
field stands under its own name unless an annotation says otherwise.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from typing import Annotated

from sfr_loc_map.metrics.condition import Condition
from sfr_loc_map.metrics.json_records import Inline, Key
from sfr_loc_map.metrics.modes import AssociationMode, CallKind, CloudKind, Rebase, VerdictState
from sfr_loc_map.metrics.score_details import Details

Interval = tuple[float, float]
"""Lower and upper bound of a 95 % interval."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Statistic:
    """Mean and scatter of one error.

    Attributes:
        mean: Sum of the values over n; of a vector the norm of the mean vector [4.1.3].
        sigma: `sqrt(sum (e_i - mean)^2 / (n - 1))`; of a vector the norm of the sigmas of its axes [4.1.3].
        mean_plus_3sigma: `|mean| + 3 sigma`.
    """

    mean: float | None
    sigma: float | None
    mean_plus_3sigma: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class IntervalStatistic(Statistic):
    """Mean and scatter of one error over sub-trajectories, with the interval of their sum.

    Attributes:
        mean_plus_3sigma_ci95: 95 % interval of mean + 3 sigma by circular block bootstrap; see `metrics.confidence`.
    """

    mean_plus_3sigma_ci95: Interval | None


@dataclass(frozen=True, slots=True, kw_only=True)
class SampleStatistic:
    """Mean, scatter and percentiles of a set of single values.

    Attributes:
        count: Number of values n.
        mean: `sum e_i / n`.
        sigma: `sqrt(sum (e_i - mean)^2 / (n - 1))` [4.1.3].
        mean_plus_3sigma: `mean + 3 sigma`.
        p50: Median, interpolated linearly between values.
        p95: 95th percentile, alike.
    """

    count: int
    mean: float | None
    sigma: float | None
    mean_plus_3sigma: float | None
    p50: float | None
    p95: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class NeesPart:
    """Normalised estimation error squared of some components (Bar-Shalom, Li, Kirubarajan 2001, section 5.4).

    Attributes:
        mean: `sum e_i^T Q_i^-1 e_i / n`, Q what the covariance grew by over the sub-trajectory.
        expected: Number of components: the mean of an honest covariance.
        interval95: 2.5 % and 97.5 % points of chi-square with `expected n` degrees of freedom, over n.
        consistent: Whether the mean lies in it.
    """

    mean: float | None
    expected: float
    interval95: Interval | None
    consistent: bool | None


@dataclass(frozen=True, slots=True, kw_only=True)
class NeesScore:
    """Whether the published covariance is honest; over sub-trajectories that share no frame.

    Attributes:
        count: Sub-trajectories with a usable covariance.
        not_usable: Sub-trajectories over which the covariance did not grow, so that it cannot be tested.
        pose: Position and attitude, 6 components.
        position: 3 components.
        attitude: 3 components.
    """

    count: int
    not_usable: int
    pose: NeesPart
    position: NeesPart
    attitude: NeesPart


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorComponents:
    """The position error by directions, m, means with their signs.

    Attributes:
        x_m: Along x of DS.
        y_m: Along y of DS.
        z_m: Along z of DS.
        along_m: Along the horizontal direction of the true displacement from N to N+x.
        cross_m: To the left of it.
        vertical_m: Along z of DS.
    """

    x_m: Statistic
    y_m: Statistic
    z_m: Statistic
    along_m: Statistic
    cross_m: Statistic
    vertical_m: Statistic


@dataclass(frozen=True, slots=True, kw_only=True)
class ConditionScore:
    """The errors over the sub-trajectories of one condition [4.1.1, 4.1.2, 4.2.3].

    Attributes:
        count: Number of sub-trajectories n.
        condition: What ends a sub-trajectory [4.1.1].
        spacing_frames: Frames from one start to the next.
        rebase: What is taken from the estimate at N: `T_gt(N) inv(T_est(N)) T_est(N+x)` is compared with `T_gt(N+x)`
            (pose), or only the position offset at N is taken away (position) [4.1.2].
        position_m: Position error in DS, estimate less truth: norm of the mean vector, norm of the sigmas [4.2.3.1].
        attitude_deg: `2 atan2(|v|, |w|)` of the rotation (v, w) between estimate and truth, never negative [4.2.3.2].
        heading_deg: Heading of the RB x-axis, estimate less truth, in (-180, 180]; mean with its sign [4.2.3.3].
        overlap: Starts within one sub-trajectory on average; n / overlap of them are independent.
        nees: Consistency of the covariance, None where none was published.
        components: Position error by directions.
    """

    count: int
    condition: Condition
    spacing_frames: int
    rebase: Rebase
    position_m: IntervalStatistic
    attitude_deg: IntervalStatistic
    heading_deg: IntervalStatistic
    overlap: float
    nees: NeesScore | None
    components: ErrorComponents


@dataclass(frozen=True, slots=True, kw_only=True)
class DistanceScore:
    """The errors over sub-trajectories of one length, for the error against distance.

    Attributes:
        distance_m: Length of the sub-trajectories.
        count: Their number.
        position_m: As in `ConditionScore`.
        attitude_deg: As in `ConditionScore`.
        heading_deg: As in `ConditionScore`.
    """

    distance_m: float
    count: int
    position_m: Statistic
    attitude_deg: Statistic
    heading_deg: Statistic


@dataclass(frozen=True, slots=True, kw_only=True)
class AssociationCounts:
    """What became of the poses given.

    Attributes:
        estimate_poses: Estimates given.
        truth_poses: True poses given.
        estimate_duplicates: Estimates left out because a later one has the same stamp.
        truth_duplicates: The same of the truth.
        estimate_unordered: Estimates that came after one with a later stamp (sorted, not left out).
        truth_unordered: The same of the truth.
        late: Poses left out of a live score because they came after their time had been scored.
        exact: Frames whose stamps are equal.
        near: Frames whose stamps differ within the tolerance.
        interpolated: Frames with interpolated truth.
        lost: Frames at which the localiser was lost.
        largest_difference_ns: Of stamps of one frame.
        largest_gap_ns: Of the truth interpolated.
    """

    estimate_poses: int = 0
    truth_poses: int = 0
    estimate_duplicates: int = 0
    truth_duplicates: int = 0
    estimate_unordered: int = 0
    truth_unordered: int = 0
    late: int = 0
    exact: int = 0
    near: int = 0
    interpolated: int = 0
    lost: int = 0
    largest_difference_ns: int = 0
    largest_gap_ns: int = 0

    @property
    def matched(self) -> int:
        """Number of frames."""
        return self.exact + self.near + self.interpolated

    def __add__(self, other: AssociationCounts) -> AssociationCounts:
        """Return the counts of both."""
        values = {item.name: getattr(self, item.name) + getattr(other, item.name) for item in fields(self)}
        for name in ("largest_difference_ns", "largest_gap_ns"):
            values[name] = max(getattr(self, name), getattr(other, name))
        return AssociationCounts(**values)


@dataclass(frozen=True, slots=True, kw_only=True)
class AssociationScore:
    """How estimates found their truth.

    Attributes:
        counts: What became of the poses.
        mode: How it was done.
        tolerance_s: Stamps this close are the same.
        max_gap_s: Longest gap of the truth that is interpolated.
    """

    counts: Annotated[AssociationCounts, Inline()]
    mode: Annotated[AssociationMode, Key("truth")]
    tolerance_s: float
    max_gap_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class TrajectoryScore:
    """The errors of a trajectory.

    Attributes:
        first: Score of the first condition.
        matched: Frames: poses of the truth that have an estimate.
        estimate_poses: Estimates given.
        lost: Frames at which the localiser was lost: they count like any other.
        path_length_m: Length of the truth's path over the frames.
        duration_s: From the first to the last frame.
        discarded_starts: Starts that waited for their end through too many others.
        association: How estimates found their truth.
        several: Scores of all conditions if there are more than one, otherwise empty; see `conditions`.
        by_distance: Error against distance.
    """

    first: Annotated[ConditionScore, Inline()]
    matched: int
    estimate_poses: int
    lost: int
    path_length_m: float
    duration_s: float | None
    discarded_starts: Annotated[int, Key("starts_given_up")]
    association: AssociationScore
    several: Annotated[tuple[ConditionScore, ...], Key("conditions")] = ()
    by_distance: tuple[DistanceScore, ...]

    @property
    def conditions(self) -> tuple[ConditionScore, ...]:
        """Scores of all conditions, in the order of the settings."""
        return self.several or (self.first,)

    def of(self, condition: Condition) -> ConditionScore | None:
        """Return the score of a condition, None if it was not scored."""
        return next((item for item in self.conditions if item.condition == condition), None)


@dataclass(frozen=True, slots=True, kw_only=True)
class DisparityStatistic:
    """The disparity errors that the depth errors amount to, `f b / Z - f b / Z_true`, px.

    Attributes:
        mean: With its sign.
        sigma: With Bessel's correction.
        p50_abs: Median of the absolute values.
        p95_abs: 95th percentile of the absolute values.
    """

    mean: float | None
    sigma: float | None
    p50_abs: float | None
    p95_abs: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class SigmaNees:
    """Whether the sigma of map points is honest: squares of (error along the ray / sigma), one point of each block.

    Attributes:
        count: Points n.
        mean: `sum (e_i / sigma_i)^2 / n`.
        median: Of the squares: the bulk, without the gross errors.
        expected: Mean of an honest sigma.
        expected_median: Median of chi-square with one degree of freedom.
        interval95: 2.5 % and 97.5 % points of chi-square with n degrees of freedom, over n.
    """

    count: int
    mean: float
    median: float
    expected: float
    expected_median: float
    interval95: Interval


@dataclass(frozen=True, slots=True, kw_only=True)
class RangeScore:
    """The point errors whose true range lies in [from_m, to_m).

    Attributes:
        from_m: Nearest true range.
        to_m: Farthest true range, itself not included.
        coverage: As in `MapScore`, of this range.
        point_error_m: As in `PointErrorScore`.
        disparity_error_px: As in `PointErrorScore`.
    """

    from_m: float
    to_m: float
    coverage: float | None
    point_error_m: Annotated[SampleStatistic, Inline()]
    disparity_error_px: DisparityStatistic


@dataclass(frozen=True, slots=True, kw_only=True)
class PairScore:
    """The points of one pair.

    Attributes:
        pair: Number of the pair.
        coverage: As in `MapScore`, of this pair.
        point_error_m: As in `PointErrorScore`.
    """

    pair: int
    coverage: float | None
    point_error_m: SampleStatistic


@dataclass(frozen=True, slots=True, kw_only=True)
class PointErrorScore:
    """The errors of points against the surface that their pixels see [4.3.4].

    Attributes:
        points_without_truth: Points whose pixel has no truth (sky): not counted below.
        point_error_m: `|truth - estimate|` of every point whose pixel has a truth [4.3.4].
        disparity_error_px: The same as an error of the disparity.
        sigma_nees: Consistency of the points' sigma, None where there are fewer than two.
        by_range: By range of the truth from the left optical centre.
        by_pair: By pair.
    """

    points_without_truth: int
    point_error_m: SampleStatistic
    disparity_error_px: DisparityStatistic
    sigma_nees: SigmaNees | None
    by_range: tuple[RangeScore, ...]
    by_pair: tuple[PairScore, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class MapScore:
    """The errors and the coverage of a cloud.

    Attributes:
        pairs: Mapping pairs of the truth.
        points: Points of the cloud.
        cloud: Whether it is fused; None where the points' pixels are not known.
        coverage: Single pairs: of the left pixels whose truth lies in the scored range the share that has a point.
            Fused: the share of those true points with a point nearer than two pixel footprints, `2 Z / f`.
        coverage_range_m: Scored range [low, high).
        nearest_only: Whether the points' pixels are not known, so that only the nearest true points can be compared.
        errors: Errors against the surface that the pixels see; None where they are not known.
        nearest_distance_m: Distance to the nearest true point, which reads low; None where pixels are known.
    """

    pairs: int
    points: int
    cloud: CloudKind | None = None
    coverage: float | None
    coverage_range_m: tuple[float, float]
    nearest_only: bool
    errors: Annotated[PointErrorScore | None, Inline()] = None
    nearest_distance_m: SampleStatistic | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class StageTime(SampleStatistic):
    """The times of one stage over the calls that had it, s.

    Attributes:
        max: Longest.
    """

    max: float


@dataclass(frozen=True, slots=True, kw_only=True)
class CallScore(SampleStatistic):
    """The wall-clock times of all calls of one kind, s [4.2.1].

    Attributes:
        p99: 99th percentile.
        max: Longest.
        first: The first call, which may load or compile.
        max_after_first: Longest of the others.
        clock: Clock they were measured with; a host time is never a time of the target.
        stages: Times of the stages of a call by name, where the calls tell them.
    """

    p99: float | None
    max: float | None
    first: float | None
    max_after_first: float | None
    clock: str
    stages: Mapping[str, StageTime] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class TimingScore:
    """The times of calls by kind [4.2.1]; None where there was none.

    Attributes:
        localisation: Pairs localised.
        mapping: Pairs mapped.
        fusion: Sets fused.
    """

    localisation: Annotated[CallScore | None, Key("localisation_s")] = None
    mapping: Annotated[CallScore | None, Key("mapping_s")] = None
    fusion: Annotated[CallScore | None, Key("fusion_s")] = None

    def of(self, kind: CallKind) -> CallScore | None:
        """Return the times of the calls of a kind."""
        return {
            CallKind.LOCALISATION: self.localisation,
            CallKind.MAPPING: self.mapping,
            CallKind.FUSION: self.fusion,
        }[kind]

    def kinds(self) -> Iterator[tuple[CallKind, CallScore]]:
        """Yield the kinds of which there were calls."""
        for kind in CallKind:
            if (calls := self.of(kind)) is not None:
                yield kind, calls


@dataclass(frozen=True, slots=True, kw_only=True)
class PeakMemory:
    """The memory of calls of one kind [4.2.2]; None where it was not measured.

    Attributes:
        peak_bytes: Largest high-water mark of resident memory of all calls.
        above_idle_bytes: The same above the idle process.
    """

    peak_bytes: int | None
    above_idle_bytes: int | None


@dataclass(frozen=True, slots=True, kw_only=True)
class MemoryScore:
    """The memory of calls by kind [4.2.2]; None where there was none.

    Attributes:
        localisation: Pairs localised.
        mapping: Pairs mapped.
        fusion: Sets fused.
        method: How it was measured; None if nothing was.
    """

    localisation: Annotated[PeakMemory | None, Inline("localisation_")] = None
    mapping: Annotated[PeakMemory | None, Inline("mapping_")] = None
    fusion: Annotated[PeakMemory | None, Inline("fusion_")] = None
    method: str | None = None

    def of(self, kind: CallKind) -> PeakMemory | None:
        """Return the memory of the calls of a kind."""
        return {
            CallKind.LOCALISATION: self.localisation,
            CallKind.MAPPING: self.mapping,
            CallKind.FUSION: self.fusion,
        }[kind]


@dataclass(frozen=True, slots=True, kw_only=True)
class TargetScore:
    """Calls that were measured elsewhere, apart from those of this host [4.3.1, 4.3.2].

    Attributes:
        name: Name of the target.
        timing: Times.
        memory: Memory, without kinds and method where it was not measured.
    """

    name: str
    timing: TimingScore
    memory: MemoryScore


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """The verdict on one limit.

    Attributes:
        metric: Name of the figure as in the limits file, after `target ` for one of the target.
        limit: Upper bound, of `coverage_min` the lower one, in the unit of the name.
        value: The figure, None where it is undefined.
        ci95: Its 95 % interval, None where it has none.
        condition: Condition of the sub-trajectories, None outside the trajectory.
        count: Number of values the figure is made of, None where it is not made of many.
        state: Pass if `|value| <= limit`, of `coverage_min` if `value >= limit`.
        certain: Whether the interval lies on one side of the limit, None where there is no interval.
    """

    metric: str
    limit: float
    value: float | None
    ci95: Interval | None
    condition: Condition | None = None
    count: int | None
    state: Annotated[VerdictState, Key("verdict")]
    certain: bool | None


@dataclass(frozen=True, slots=True, kw_only=True)
class InputFile:
    """An input of the score.

    Attributes:
        path: As given.
        sha256: Hash of the content.
    """

    path: str
    sha256: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Provenance:
    """What the score was made of.

    Attributes:
        version: Of this suite.
        inputs: Files by role.
        configuration: Settings in force.
        host: Machine, system and Python.
        time: When it was made, ISO 8601.
    """

    version: str
    inputs: Mapping[str, InputFile] = field(default_factory=dict)
    configuration: Mapping[str, object] = field(default_factory=dict)
    host: Mapping[str, str] = field(default_factory=dict)
    time: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Score:
    """The whole score; parts that are absent are None or empty.

    Attributes:
        trajectory: Errors of the trajectory.
        map: Errors of the map.
        timing: Times of the calls on this host.
        memory: Memory of the calls on this host.
        target: Calls that were measured elsewhere.
        verdicts: One for each limit, in the order of the limits.
        warnings: One line for each.
        provenance: What it was made of.
        details: What figures are drawn from.
    """

    trajectory: TrajectoryScore | None = None
    map: MapScore | None = None
    timing: TimingScore | None = None
    memory: MemoryScore | None = None
    target: TargetScore | None = None
    verdicts: tuple[Verdict, ...]
    warnings: tuple[str, ...] = ()
    provenance: Provenance | None = None
    details: Details | None = None

    @property
    def failed(self) -> tuple[Verdict, ...]:
        """The verdicts that are `fail`."""
        return tuple(item for item in self.verdicts if item.state is VerdictState.FAIL)
