"""The part `trajectory` of the score."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Annotated

from sfr_loc_map.metrics.condition import Condition
from sfr_loc_map.metrics.modes import AssociationMode, Rebase
from sfr_loc_map.metrics.records.json_records import Inline, Key
from sfr_loc_map.metrics.records.statistic_records import Interval, IntervalStatistic, Statistic


@dataclass(frozen=True, slots=True, kw_only=True)
class NeesPart:
    """Normalised estimation error squared of some components (Bar-Shalom, Li, Kirubarajan 2001, section 5.4).

    Attributes:
        mean: `sum e_i^T Q_i^-1 e_i / n`, Q the covariance of the end given the start.
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
        from_steps: Of those counted, how many were judged by the covariances of the steps between; the others by the
            growth of the published covariance.
        pose: Position and attitude, 6 components.
        position: 3 components.
        attitude: 3 components.
    """

    count: int
    not_usable: int
    from_steps: int = 0
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
        degraded: Frames at which it gave a pose that it has a reason to doubt.
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
    degraded: int = 0
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
        degraded: Frames at which it gave a pose that it has a reason to doubt: they count like any other.
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
    degraded: int = 0
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
