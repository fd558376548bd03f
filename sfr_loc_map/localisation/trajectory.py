"""The path of the rover: last pose, datum, history and accumulated errors, and their change with each kind of pair.

Each function takes an immutable `PathState` and returns the next one. The functions that lead to a published pose also
return the step to that pose.

| pair | function |
|---|---|
| the first pair | `arrived` |
| accepted | `accepted` |
| kept: repeats the previous pair, or its image contradicts its pose | `kept` |
| a new window begins at the last pose | `restarted` |
| lost | `lost` |
| a keyframe, after it was adjusted in the background | `adjusted` |

`given` accepts an external pose. `with_pending_pose` applies the pose after the first pair at or after its stamp.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.backend.sliding_window import LandmarkMap, SlidingWindow
from sfr_loc_map.localisation.datum import MAX_AHEAD_NS, MAX_START_AHEAD_NS, Datum, PendingPose
from sfr_loc_map.localisation.estimate import StartPose, StepEstimate
from sfr_loc_map.localisation.history import History, PastPose
from sfr_loc_map.localisation.motion_model import LastPose
from sfr_loc_map.localisation.motion_size import size_of
from sfr_loc_map.localisation.uncertainty.accepted_pair import AcceptedPair
from sfr_loc_map.localisation.uncertainty.inflation import inflation_of, unobserved_during, unobserved_size
from sfr_loc_map.localisation.uncertainty.path_errors import NOTHING, LocatedCovariance, Origin, PathErrors
from sfr_loc_map.localisation.uncertainty.published_pose import PublishedPose
from sfr_loc_map.localisation.uncertainty.rover_model import RoverModel
from sfr_loc_map.message_stamps import NS_PER_S

MAX_LATER_PERIODS = 1.5
"""Maximum number of periods between the last accepted pose and a later external pose that applies to it. If the next
pair is kept, an external pose for this pair is one period later. With a limit of exactly one period, the jitter of the
stamps would decide whether the map is discarded. The period is the shorter of two times: that between the last two
accepted pairs, and that between the newest two pairs. Each of these times may span missing pairs. Until a pair is
accepted in a new window, the period is the time between the newest two pairs."""


@dataclass(frozen=True, slots=True, eq=False)
class PathState:
    """Poses and accumulated errors so far."""

    last: LastPose  #: Last known pose in the present map, and the motion to it.
    datum: Datum  #: Pose of the world in DS.
    errors: PathErrors  #: Components of the covariance of the pose.
    published: PublishedPose  #: The pose published last, at which the next step starts.
    history: History = History()  #: Past poses, to which an external pose can be applied.
    arrived_ns: int | None = None  #: Stamp of the newest pair, refused or not; None before the first pair.
    period_ns: int = 0  #: Time between the newest two pairs, refused or not; 0 before the second pair.


def started(start: StartPose, model: RoverModel) -> PathState:
    """Return the path before the first pair."""
    last = LastPose(Transform.identity(), Transform.identity(), None)
    path = PathState(last, Datum(Transform.identity(), start), PathErrors(Origin(NOTHING)), PublishedPose())
    return _placed(path, start, start.stamp_ns, model)


def arrived(path: PathState, stamp_ns: int) -> PathState:
    """Return the path after a pair arrived. The first pair decides when the start pose is valid.

    A start pose without a stamp is valid at the first pair. A start pose with a later stamp is used from the first pair
    on, with the uncertainty of the motion until its stamp, and is applied again at its stamp.
    """
    if path.arrived_ns is not None:
        return replace(path, arrived_ns=stamp_ns, period_ns=stamp_ns - path.arrived_ns)
    path = replace(path, arrived_ns=stamp_ns)
    known_ns = path.last.known_ns
    if known_ns is None or known_ns > stamp_ns + MAX_START_AHEAD_NS:
        return replace(path, last=path.last.at_stamp(stamp_ns))
    if known_ns > stamp_ns:
        return replace(path, datum=replace(path.datum, pending=PendingPose(path.datum.placed, MAX_START_AHEAD_NS)))
    return path


# ---- poses from images


def accepted(path: PathState, pair: AcceptedPair, model: RoverModel) -> tuple[PathState, StepEstimate]:
    """Return the path with the pose of an accepted pair, and the step to it."""
    since = path.last.since_last(pair.stamp_ns, pair.T_world_left)
    added = inflation_of(
        pair.inflation,
        unobserved=unobserved_size(path.last.speed, since.seconds, model.bounds),
        moved=since.size,
        other_distance=pair.other_distance,
        sources=model.sources,
    )
    errors = path.errors.with_pair(pair, path.last.T_world_left, added, model)
    published, step = path.published.to_pair(pair, path.last.speed, added, model)
    last = path.last.tracked(
        pair.stamp_ns, pair.T_world_left, since, period_ns=path.period_ns, was_known=pair.was_known
    )
    # after a kept pair, the pose published last is newer than the last tracked pair
    was_tracked = pair.was_known and path.published.stamp_ns == path.last.tracked_ns
    follows_directly = was_tracked and path.last.is_followed_by(pair.stamp_ns)
    history = path.history.with_pose(_past_pose(last, errors, follows_directly=follows_directly))
    return replace(path, last=last, errors=errors, published=published, history=history), step


def kept(path: PathState, stamp_ns: int, model: RoverModel) -> tuple[PathState, StepEstimate]:
    """Return the path with the last pose kept at a stamp, and the step; the rover may have moved unobserved."""
    errors = path.errors.kept(_unobserved_of_left(path, stamp_ns, model))
    published, step = _step_to_kept(path, stamp_ns, model)
    return replace(path, errors=errors, published=published), step


def restarted(
    path: PathState, stamp_ns: int, landmark_map: LandmarkMap, model: RoverModel
) -> tuple[PathState, StepEstimate]:
    """Return the path with a new window that begins at the last pose, and the step to it."""
    until_now = path.errors.kept(_unobserved_of_left(path, stamp_ns, model))
    errors = until_now.restarted(
        path.last.T_world_left.translation,
        first_image=model.blur(landmark_map.landmarks.median_depth).covariance,
        in_window=model.sources.adjustment_inflation * landmark_map.window.covariance,
    )
    published, step = _step_to_kept(path, stamp_ns, model)
    published = published.without_errors()
    last = path.last.restarted(stamp_ns)
    history = path.history.with_pose(_past_pose(last, errors, follows_directly=False))
    return replace(path, last=last, errors=errors, published=published, history=history), step


def lost(path: PathState) -> PathState:
    """Return the path after a lost pair."""
    return replace(path, last=path.last.without_prediction())


def adjusted(path: PathState, window: SlidingWindow, model: RoverModel, *, has_yaw_step: bool) -> PathState:
    """Return the path that continues from the adjusted pose of the last pair, the newest keyframe of a window.

    An external pose for this pair applies to the adjusted pose, because later poses continue from it.
    """
    T_world_left = Transform(*window.newest_pose)
    published = path.published
    if has_yaw_step:
        published = published.displaced(size_of(path.last.T_world_left.inverse() @ T_world_left))
    errors = path.errors.adjusted(model.sources.adjustment_inflation * window.covariance)
    last = path.last.adjusted(T_world_left)
    history = path.history
    if history.last_ns == last.tracked_ns:
        follows_directly = history.poses[-1].follows_directly
        history = history.with_last(_past_pose(last, errors, follows_directly=follows_directly))
    return replace(path, last=last, errors=errors, published=published, history=history)


def _past_pose(last: LastPose, errors: PathErrors, *, follows_directly: bool) -> PastPose:
    """Return the last pose for the history."""
    return PastPose(last.tracked_ns, last.T_world_left, follows_directly, last.T_world_left.translation, errors)


def _step_to_kept(path: PathState, stamp_ns: int, model: RoverModel) -> tuple[PublishedPose, StepEstimate]:
    """Return the last known pose, kept at a stamp, and the step to it."""
    last = path.last
    unobserved_s = last.unobserved_s(stamp_ns)
    return path.published.to_kept(stamp_ns, last.T_world_left, unobserved_s=unobserved_s, speed=last.speed, model=model)


def _unobserved_of_left(path: PathState, stamp_ns: int, model: RoverModel) -> FloatArray:
    """Return the covariance of the unobserved motion up to a stamp, for the left camera in the world."""
    last = path.last
    rebased_ns = path.datum.rebased_ns
    unobserved_s = last.unobserved_s(stamp_ns)
    if rebased_ns is not None:  # a later external pose is the kept pose itself at its stamp
        unobserved_s = min(unobserved_s, (stamp_ns - rebased_ns) / NS_PER_S)
    return model.covariance_at(last.T_world_left, unobserved_during(last.speed, unobserved_s, model))


# ---- external poses


def given(path: PathState, pose: StartPose, model: RoverModel) -> PathState:
    """Return the path with an external pose. After the first pair, this pose waits for a pair at or after its stamp."""
    if path.arrived_ns is None:
        return _placed(path, pose, pose.stamp_ns, model)
    return replace(path, datum=replace(path.datum, pending=PendingPose(pose, MAX_AHEAD_NS)))


def with_pending_pose(path: PathState, stamp_ns: int, model: RoverModel) -> tuple[PathState, bool]:
    """Return the path with the pending external pose applied if its stamp is reached, and whether to discard the map.

    An external pose that is at most `MAX_LATER_PERIODS` later than the last accepted pose applies to that pose. The
    unobserved motion between the two counts from the next accepted pair on (`Origin.of_accepted`). If the external
    pose is still later, its position in the map is unknown. The map is then discarded, and the motion from the stamp of
    the external pose to the pair is unobserved.
    """
    pending = path.datum.pending
    if pending is None:
        return path, False
    at_ns = pending.stamp_at(stamp_ns)
    if at_ns > stamp_ns:
        return path, False
    path = replace(path, datum=replace(path.datum, pending=None))
    last_ns = path.history.last_ns
    discards_map = last_ns is None or at_ns - last_ns > MAX_LATER_PERIODS * _shortest_period_ns(path)
    apply = _placed if discards_map else _rebased
    path = apply(path, pending.pose, at_ns, model)
    if last_ns is None or at_ns > last_ns:  # the present pair is kept or lost
        path = replace(path, errors=path.errors.kept(_unobserved_of_left(path, stamp_ns, model)))
    return path, discards_map


def pose_at(path: PathState, stamp_ns: int, model: RoverModel) -> Transform | None:
    """Return the pose of RB in DS to which an external pose with a stamp applies; None without a past pose."""
    if not path.history.poses:
        return None
    past, _ = path.history.at(stamp_ns)
    return path.datum.T_ds_world @ past.T_world_left @ model.T_left_rb


def _shortest_period_ns(path: PathState) -> int:
    """Return the shorter time between two pairs (`MAX_LATER_PERIODS`), ns. A window without accepted pairs has one."""
    motion_ns = path.last.motion_ns
    return path.period_ns if motion_ns is None else min(motion_ns, path.period_ns)


def _placed(path: PathState, pose: StartPose, stamp_ns: int | None, model: RoverModel) -> PathState:
    """Return the path whose last pose is an external pose, known at a stamp. The earlier path is discarded."""
    T_world_left = path.last.T_world_left
    T_ds_world, covariance = _with_external(T_world_left, pose, model)
    return replace(
        path,
        last=path.last.at_stamp(stamp_ns),
        datum=replace(path.datum, T_ds_world=T_ds_world, placed=pose, rebased_ns=None),
        errors=path.errors.placed(LocatedCovariance(T_world_left.translation, covariance)),
        history=History(),
    )


def _rebased(path: PathState, pose: StartPose, at_ns: int, model: RoverModel) -> PathState:
    """Return the path, moved so that it passes through an external pose at a past stamp.

    Errors are accumulated from this stamp. The map has the errors of the image of the past pose, and of the motion from
    the past pose to the stamp, relative to the external pose. If the stamp is later than the last past pose, this pose
    is kept, and the published pose at the stamp is the external pose itself. These errors then count from the next
    accepted pair on.
    """
    past, apart_s = path.history.at(at_ns)
    is_present = past.stamp_ns == path.history.last_ns
    is_later = is_present and at_ns > past.stamp_ns
    T_ds_world, covariance = _with_external(past.T_world_left, pose, model)
    motion = model.covariance_at(past.T_world_left, unobserved_during(path.last.speed, apart_s, model))
    origin = Origin(
        external=LocatedCovariance(past.position, covariance),
        shared=past.errors.shared(past.position),
        sums=past.errors.sums,
        of_accepted=motion + past.errors.alone,
    )
    if not is_later:
        origin = origin.with_accepted()
    errors = path.errors.rebased(origin, is_present=is_present)
    return replace(path, datum=replace(path.datum, T_ds_world=T_ds_world, rebased_ns=at_ns), errors=errors)


def _with_external(T_world_left: Transform, pose: StartPose, model: RoverModel) -> tuple[Transform, FloatArray]:
    """Return the pose of the world in DS if an external pose is that of RB at a pose of the left camera in the world.

    The second value is the covariance `(6, 6)` of the external pose, for the left camera in the world.
    """
    T_ds_world = pose.T_ds_rb @ model.T_rb_left @ T_world_left.inverse()
    covariance = model.covariance_of_left(
        pose.covariance, R_world_frame=T_ds_world.rotation.T, R_world_left=T_world_left.rotation
    )
    return T_ds_world, covariance
