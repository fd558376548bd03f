"""The path of the rover: its poses so far with their accumulated errors, and how each event changes them.

    pair (accepted, kept, lost, first of a window) ----> PathState, step to the published pose
    adjustment of a keyframe --------------------------> PathState
    external pose (start of the run, or set later) ----> PathState, whether the map is discarded

The localiser estimates poses in its own world frame. An external pose of RB in DS defines the transform between the two
frames, which is the datum. An external pose is given as a `StartPose`, and waits for its stamp in `Datum.waiting`. Once
the pose is applied, all errors are relative to this pose (`Origin`). `uncertainty` computes the covariances, and
`motion_model` the initial guesses of the next pose.

**When an external pose applies.** `pose_set` accepts a pose, and a later pose replaces a pose that still waits for its
stamp:

| pose | applies at |
|---|---|
| without a stamp | the next pair, even if that pair is refused |
| start pose up to `MAX_START_AHEAD_NS` after the first pair | the first pair, and again at its stamp if that is later |
| pose set later, up to `MAX_AHEAD_NS` after the next pair | its stamp |
| with a still later stamp, which indicates a different clock | the next pair |

The first pair fixes the stamp of the start pose before the pair is processed (`arrived`). After each pair,
`pose_applied` applies a pose that was set later and whose stamp is reached. The guards have then decided on the pair,
and an external pose does not change their decision. What happens depends on where the stamp lies relative to the last
accepted pair (a pair that began a window counts as accepted here):

            accepted pairs            last accepted pair       present pair (kept or lost)
    ---------x-----x-----x-----x-----------x------------------------o----------------------> stamp
             |<------- 1 past ------------>|<--- 2 later --->|<---------- 3 far ---->|
                                           |  1.5 periods    |

| stamp | pose to which the external pose applies | map |
|---|---|---|
| 1 past: up to the last accepted pair | the pair at the stamp, or between two pairs (`History.at`) | anchored |
| 2 later: up to `MAX_LATER_PERIODS` later | the last accepted pair | anchored |
| 3 far: still later, or no pair was accepted yet | the last known pose | discarded, path reset |

Anchoring moves map and path in DS as one rigid body, so that the path passes through the external pose, and errors
count from this pose on. In case 2, the present pose is the external pose itself. The poses of the next accepted pairs
continue from the last accepted pair, so that their covariance contains the unobserved motion between that pair and the
stamp (`Origin.added_by_next`). In case 3, the position of the external pose in the map is unknown. The map is therefore
discarded, and the motion from the stamp to the pair is unobserved.

**Stamps.** `last.known_ns` is the stamp since which the motion is unobserved, and `last.accepted_ns` is the stamp of
the last pair that was accepted or began a window. The stamps differ only after a start pose or a reset, until the next
such pair. A reset changes `known_ns`, and empties the history.
"""

from __future__ import annotations

from bisect import bisect_left
from typing import NamedTuple

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.transform import Transform, interpolated
from sfr_loc_map.localisation.backend.sliding_window import LandmarkMap
from sfr_loc_map.localisation.estimate import StartPose, StepEstimate
from sfr_loc_map.localisation.motion_model import LastPose
from sfr_loc_map.localisation.motion_size import size_of
from sfr_loc_map.localisation.uncertainty.error_sources import (
    RoverModel,
    inflation_of,
    unobserved_during,
    unobserved_size,
)
from sfr_loc_map.localisation.uncertainty.pose_covariance import (
    NOTHING,
    AcceptedPair,
    LocatedCovariance,
    Origin,
    PathErrors,
)
from sfr_loc_map.localisation.uncertainty.step_covariance import PublishedPose
from sfr_loc_map.message_stamps import NS_PER_S

HISTORY_PAIRS = 1000  #: Number of past pairs to which an external pose can be applied: 100 s at 10 Hz.
MAX_AHEAD_NS = 10 * NS_PER_S
"""Maximum lead of a pose's stamp over the images. A larger lead indicates a different clock, and the pose is then
applied to the next pair."""
MAX_START_AHEAD_NS = 600 * NS_PER_S  #: Maximum lead of a start pose, larger because a ground truth may begin late.
MAX_LATER_PERIODS = 1.5
"""Maximum number of periods between the last accepted pose and a later external pose that applies to it. If the pair
after the last accepted pair is kept, an external pose for the kept pair is one period later. With a limit of exactly
one period, the jitter of the stamps would decide whether the map is discarded. The period is the shorter of two times:
that between the last two accepted pairs, and that between the newest two pairs. Each of these times may span missing
pairs. Until a pair is accepted in a new window, the period is the time between the newest two pairs."""


class PastPose(NamedTuple):
    """A past pose and its errors, for the uncertainty of later poses relative to this pose."""

    stamp_ns: int
    T_world_left: Transform
    #: Whether the pair directly follows that of the previous past pose, without a refused or missing pair in between.
    follows_directly: bool
    position: FloatArray  #: `(3,)` position at which `errors` holds, m; `T_world_left` may be interpolated.
    errors: PathErrors  #: Errors of the pose.


class History(NamedTuple):
    """Past poses, oldest first, to which external poses with past stamps are applied."""

    poses: tuple[PastPose, ...] = ()

    def with_pose(self, pose: PastPose) -> History:
        """Return the history with a further pose. The oldest pose is removed from a full history."""
        return History((*self.poses[-(HISTORY_PAIRS - 1) :], pose))

    def with_last(self, pose: PastPose) -> History:
        """Return the history with its last pose replaced."""
        return History((*self.poses[:-1], pose))

    def at(self, stamp_ns: int) -> tuple[PastPose, float]:
        """Return the pose at a stamp, and the time between the returned pose and the stamp, s.

        The pose is interpolated between two consecutive pairs, and the errors are those of the later pair. If the two
        pairs are not consecutive, or if the stamp is outside the history, the nearest pose is returned.
        """
        last = self.poses[-1]
        if stamp_ns > last.stamp_ns:
            return last, (stamp_ns - last.stamp_ns) / NS_PER_S
        after = bisect_left(self.poses, stamp_ns, key=lambda pose: pose.stamp_ns)
        later = self.poses[after]
        if later.stamp_ns == stamp_ns:
            return later, 0.0
        if after == 0:
            return later, (later.stamp_ns - stamp_ns) / NS_PER_S
        earlier = self.poses[after - 1]
        if later.follows_directly:
            fraction = (stamp_ns - earlier.stamp_ns) / (later.stamp_ns - earlier.stamp_ns)
            between = interpolated(earlier.T_world_left, later.T_world_left, fraction)
            return later._replace(stamp_ns=stamp_ns, T_world_left=between), 0.0
        nearest = min(earlier, later, key=lambda pose: abs(pose.stamp_ns - stamp_ns))
        return nearest, abs(nearest.stamp_ns - stamp_ns) / NS_PER_S


class Datum(NamedTuple):
    """Pose of the localiser's world frame in DS, and the external pose that will change it next."""

    T_ds_world: Transform  #: Takes points in the world to DS.
    #: External pose that waits for its stamp. Before the first pair: the start pose, which is already applied.
    waiting: StartPose | None = None
    waiting_ns: int | None = None  #: Stamp at which this pose applies; None until the next pair decides this.
    #: Stamp of the last external pose to which the map was anchored; None if the map was discarded since then. If this
    #: stamp is later than the last accepted pair, the motion of a kept pose is unobserved since this stamp.
    anchored_ns: int | None = None


class PathState(NamedTuple):
    """Poses and accumulated errors so far. Each public method but `pose_at` is an event, and returns the next path."""

    last: LastPose  #: Last known pose in the present map, and the motion to it.
    datum: Datum  #: Pose of the world in DS.
    errors: PathErrors  #: Components of the covariance of the pose.
    published: PublishedPose  #: The pose published last, at which the next step starts.
    history: History = History()  #: Past poses, to which an external pose can be applied.
    arrived_ns: int | None = None  #: Stamp of the newest pair, refused or not; None before the first pair.
    period_ns: int = 0  #: Time between the newest two pairs, refused or not; 0 before the second pair.

    @classmethod
    def started(cls, start: StartPose, model: RoverModel) -> PathState:
        """Return the path before the first pair."""
        last = LastPose(Transform.identity(), Transform.identity(), None)
        errors = PathErrors(Origin(NOTHING))
        return cls(last, Datum(Transform.identity()), errors, PublishedPose()).pose_set(start, model)

    # ---- pairs

    def arrived(self, stamp_ns: int) -> PathState:
        """Return the path after a pair arrived, before the pair is processed.

        The first pair decides when the start pose is valid. A start pose with a later stamp is used from the first pair
        on, with the uncertainty of the motion until its stamp, and is applied again at its stamp.
        """
        if self.arrived_ns is not None:
            return self._replace(arrived_ns=stamp_ns, period_ns=stamp_ns - self.arrived_ns)
        start = self.datum.waiting
        assert start is not None, "the start pose"
        valid_ns = _valid_ns(start, stamp_ns, MAX_START_AHEAD_NS)
        datum = self.datum._replace(waiting=start if valid_ns > stamp_ns else None, waiting_ns=valid_ns)
        return self._replace(datum=datum, last=self.last.at_stamp(valid_ns), arrived_ns=stamp_ns)

    def accepted(self, pair: AcceptedPair, model: RoverModel) -> tuple[PathState, StepEstimate]:
        """Return the path with the pose of an accepted pair, and the step to it."""
        T_last_now = self.last.T_world_left.inverse() @ pair.T_world_left
        moved = size_of(T_last_now)
        added = inflation_of(
            pair.inflation,
            unobserved=unobserved_size(self.last.speed, self.last.unobserved_s(pair.stamp_ns), model.bounds),
            moved=moved,
            other_distance=pair.other_distance,
            sources=model.sources,
        )
        errors = self.errors.accepted(pair, self.last.T_world_left, added, model)
        published, step = self.published.accepted(pair, self.last.speed, added, model)
        last = self.last.accepted(
            pair.stamp_ns, pair.T_world_left, T_last_now, moved, period_ns=self.period_ns, was_known=pair.was_known
        )
        was_accepted = pair.was_known and not self.published.is_kept  # the previous pair was neither lost nor kept
        follows_directly = was_accepted and self.last.is_followed_by(pair.stamp_ns)
        history = self.history.with_pose(_past_pose(last, errors, follows_directly=follows_directly))
        return self._replace(last=last, errors=errors, published=published, history=history), step

    def kept(self, stamp_ns: int, model: RoverModel) -> tuple[PathState, StepEstimate]:
        """Return the path with the last pose kept at a stamp, and the step; the rover may have moved unobserved."""
        errors = self.errors.kept(self._unobserved(stamp_ns, model))
        published, step = self._step_to_last(stamp_ns, model)
        return self._replace(errors=errors, published=published), step

    def window_begun(
        self, stamp_ns: int, landmark_map: LandmarkMap, model: RoverModel
    ) -> tuple[PathState, StepEstimate]:
        """Return the path with a new window that begins at the last pose, and the step to it."""
        until_now = self.errors.kept(self._unobserved(stamp_ns, model))
        errors = until_now.window_begun(
            self.last.T_world_left.translation,
            first_image=model.blur(landmark_map.landmarks.median_depth).covariance,
            in_window=model.sources.adjustment_inflation * landmark_map.covariance,
        )
        published, step = self._step_to_last(stamp_ns, model)
        published = published.window_begun()
        last = self.last.window_begun(stamp_ns)
        history = self.history.with_pose(_past_pose(last, errors, follows_directly=False))
        return self._replace(last=last, errors=errors, published=published, history=history), step

    def lost(self) -> PathState:
        """Return the path after a lost pair."""
        return self._replace(last=self.last.lost())

    def adjusted(self, landmark_map: LandmarkMap, model: RoverModel, *, has_yaw_step: bool) -> PathState:
        """Return the path that continues from the adjusted pose of the last pair, the newest keyframe of a window.

        An external pose for this pair applies to the adjusted pose, because later poses continue from it.
        """
        T_world_left = Transform(*landmark_map.window.newest_pose)
        published = self.published
        if has_yaw_step:
            published = published.adjusted(size_of(self.last.T_world_left.inverse() @ T_world_left))
        errors = self.errors.adjusted(model.sources.adjustment_inflation * landmark_map.covariance)
        last = self.last.adjusted(T_world_left)
        follows_directly = self.history.poses[-1].follows_directly
        history = self.history.with_last(_past_pose(last, errors, follows_directly=follows_directly))
        return self._replace(last=last, errors=errors, published=published, history=history)

    def _step_to_last(self, stamp_ns: int, model: RoverModel) -> tuple[PublishedPose, StepEstimate]:
        """Return the last known pose, published again at a stamp, and the step to it."""
        last = self.last
        unobserved_s = last.unobserved_s(stamp_ns)
        return self.published.kept(
            stamp_ns, last.T_world_left, unobserved_s=unobserved_s, speed=last.speed, model=model
        )

    def _unobserved(self, stamp_ns: int, model: RoverModel) -> FloatArray:
        """Return the covariance `(6, 6)` of the unobserved motion up to a stamp, for the left camera in the world."""
        unobserved_s = self.last.unobserved_s(stamp_ns)
        anchored_ns = self.datum.anchored_ns
        if anchored_ns is not None:  # a later external pose is the kept pose itself at its stamp
            unobserved_s = min(unobserved_s, (stamp_ns - anchored_ns) / NS_PER_S)
        return model.covariance_at(self.last.T_world_left, unobserved_during(self.last.speed, unobserved_s, model))

    # ---- external poses

    def pose_set(self, pose: StartPose, model: RoverModel) -> PathState:
        """Return the path with an external pose, which waits for its stamp. Before the first pair: the start pose."""
        path = self._replace(datum=self.datum._replace(waiting=pose, waiting_ns=None))
        return path._reset(pose, pose.stamp_ns, model) if self.arrived_ns is None else path

    def pose_applied(self, stamp_ns: int, model: RoverModel) -> tuple[PathState, bool]:
        """Return the path after a pair. The waiting external pose is applied if its stamp has been reached.

        The second value tells whether the map is to be discarded.
        """
        datum = self.datum
        pose = datum.waiting
        assert pose is not None, "a pose waits"
        at_ns = datum.waiting_ns
        if at_ns is None:
            at_ns = _valid_ns(pose, stamp_ns, MAX_AHEAD_NS)
        if at_ns > stamp_ns:
            return self._replace(datum=datum._replace(waiting_ns=at_ns)), False
        path = self._replace(datum=datum._replace(waiting=None, waiting_ns=None))
        has_past = bool(self.history.poses)
        later_ns = at_ns - self.last.accepted_ns
        is_far = not has_past or later_ns > MAX_LATER_PERIODS * self._shortest_period_ns
        path = path._reset(pose, at_ns, model) if is_far else path._anchored(pose, at_ns, model)
        if not has_past or later_ns > 0:  # the present pair is kept or lost
            path = path._replace(errors=path.errors.kept(path._unobserved(stamp_ns, model)))
        return path, is_far

    def pose_at(self, stamp_ns: int, model: RoverModel) -> Transform | None:
        """Return the pose of RB in DS at a past stamp (`History.at`); None without a past pose."""
        if not self.history.poses:
            return None
        past, _ = self.history.at(stamp_ns)
        return self.datum.T_ds_world @ past.T_world_left @ model.T_left_rb

    @property
    def _shortest_period_ns(self) -> int:
        """Shorter time between two pairs (`MAX_LATER_PERIODS`), ns."""
        motion_ns = self.last.motion_ns
        return self.period_ns if motion_ns is None else min(motion_ns, self.period_ns)

    def _reset(self, pose: StartPose, stamp_ns: int | None, model: RoverModel) -> PathState:
        """Return the path whose last pose is an external pose, known at a stamp. The earlier path is discarded."""
        T_world_left = self.last.T_world_left
        T_ds_world, covariance = _with_external(T_world_left, pose, model)
        return self._replace(
            last=self.last.at_stamp(stamp_ns),
            datum=self.datum._replace(T_ds_world=T_ds_world, anchored_ns=None),
            errors=self.errors.reset(LocatedCovariance(T_world_left.translation, covariance)),
            history=History(),
        )

    def _anchored(self, pose: StartPose, at_ns: int, model: RoverModel) -> PathState:
        """Return the path, moved in DS so that it passes through an external pose. Errors count from this pose on.

        The map is displaced relative to the external pose by the errors of the pair to which the pose applies, and by
        the unobserved motion between that pair and the stamp. If the stamp is later than the last accepted pair, the
        present pose is the external pose itself, and these errors count from the next accepted pair on.
        """
        past, apart_s = self.history.at(at_ns)
        last_ns = self.last.accepted_ns
        T_ds_world, covariance = _with_external(past.T_world_left, pose, model)
        unobserved = model.covariance_at(past.T_world_left, unobserved_during(self.last.speed, apart_s, model))
        origin = Origin(
            external=LocatedCovariance(past.position, covariance),
            added_by_next=unobserved + past.errors.this_pair,
            of_map=past.errors.of_map(past.position),
            sums=past.errors.sums,
        )
        if at_ns <= last_ns:  # the present pose also belongs to a pair
            origin = origin.accepted()
        errors = self.errors.anchored(origin, at_last_pair=past.stamp_ns == last_ns)
        return self._replace(datum=self.datum._replace(T_ds_world=T_ds_world, anchored_ns=at_ns), errors=errors)


def _past_pose(last: LastPose, errors: PathErrors, *, follows_directly: bool) -> PastPose:
    """Return the last pose for the history."""
    return PastPose(last.accepted_ns, last.T_world_left, follows_directly, last.T_world_left.translation, errors)


def _valid_ns(pose: StartPose, stamp_ns: int, max_ahead_ns: int) -> int:
    """Return the stamp at which a pose is valid, given the stamp of the newest pair."""
    stated_ns = pose.stamp_ns
    return stamp_ns if stated_ns is None or stated_ns > stamp_ns + max_ahead_ns else stated_ns


def _with_external(T_world_left: Transform, pose: StartPose, model: RoverModel) -> tuple[Transform, FloatArray]:
    """Return the pose of the world in DS that follows from an external pose of RB in DS.

    `T_world_left` is the pose of the left camera in the world at the same time. The second value is the covariance
    `(6, 6)` of the external pose, for the left camera in the world.
    """
    T_ds_world = pose.T_ds_rb @ model.T_rb_left @ T_world_left.inverse()
    covariance = model.covariance_of_left(
        pose.covariance, R_world_frame=T_ds_world.rotation.T, R_world_left=T_world_left.rotation
    )
    return T_ds_world, covariance
