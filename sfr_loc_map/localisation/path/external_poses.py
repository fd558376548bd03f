"""External poses of RB in DS: the start of the run, and poses that are set later. One of them defines the datum.

`pose_set` accepts a pose, and a later pose replaces a pose that is not applied yet. A pose applies at its stamp:

| pose | applies at |
|---|---|
| without a stamp | the next pair, even if that pair is refused |
| start pose up to `MAX_START_AHEAD_NS` after the first pair | the first pair, and again its stamp if it is later |
| pose set later, up to `MAX_AHEAD_NS` after the next pair | its stamp |
| with a still later stamp, which indicates a different clock | the next pair |

The first pair fixes the stamp of the start pose before the pair is processed (`at_first_pair`). After each pair,
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
| 3 far: still later, or before the first accepted pair | the last known pose | discarded, path reset |

Anchoring changes the datum alone: map and path move in DS as one rigid body, so that the path passes through the
external pose. In case 2, the present pose is the external pose itself. The poses of the next accepted pairs continue
from the last accepted pair, so that their covariance contains the unobserved motion between that pair and the stamp
(`Origin.external_of_next`). In case 3, the position of the external pose in the map is unknown. The map is therefore
discarded, and the motion from the stamp to the pair is unobserved.
"""

from __future__ import annotations

from dataclasses import replace

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.estimate import StartPose
from sfr_loc_map.localisation.motion_model import LastPose
from sfr_loc_map.localisation.path.history import History
from sfr_loc_map.localisation.path.path_state import Datum, PathState
from sfr_loc_map.localisation.uncertainty.inflation import unobserved_during
from sfr_loc_map.localisation.uncertainty.path_errors import NOTHING, LocatedCovariance, Origin, PathErrors, PathSums
from sfr_loc_map.localisation.uncertainty.published_pose import PublishedPose
from sfr_loc_map.localisation.uncertainty.rover_model import RoverModel
from sfr_loc_map.message_stamps import NS_PER_S

MAX_AHEAD_NS = 10 * NS_PER_S
"""Maximum lead of a pose's stamp over the images. A larger lead indicates a different clock; the pose is then applied
to the next pair."""
MAX_START_AHEAD_NS = 600 * NS_PER_S  #: Maximum lead of a start pose, larger because a ground truth may begin late.
MAX_LATER_PERIODS = 1.5
"""Maximum number of periods between the last accepted pose and a later external pose that applies to it. If the next
pair is kept, an external pose for this pair is one period later. With a limit of exactly one period, the jitter of the
stamps would decide whether the map is discarded. The period is the shorter of two times: that between the last two
accepted pairs, and that between the newest two pairs. Each of these times may span missing pairs. Until a pair is
accepted in a new window, the period is the time between the newest two pairs."""


def started(start: StartPose, model: RoverModel) -> PathState:
    """Return the path before the first pair."""
    last = LastPose(Transform.identity(), Transform.identity(), None)
    path = PathState(last, Datum(Transform.identity()), PathErrors(Origin.of(NOTHING, PathSums())), PublishedPose())
    return pose_set(path, start, model)


def pose_set(path: PathState, pose: StartPose, model: RoverModel) -> PathState:
    """Return the path with an external pose, which waits for its stamp. Before the first pair, it is the start pose."""
    path = replace(path, datum=replace(path.datum, pending=pose, pending_ns=None))
    return _reset(path, pose, pose.stamp_ns, model) if path.arrived_ns is None else path


def at_first_pair(path: PathState, stamp_ns: int) -> PathState:
    """Return the path at the arrival of the first pair, which decides when the start pose is valid.

    A start pose with a later stamp is used from the first pair on, with the uncertainty of the motion until its stamp,
    and is applied again at its stamp.
    """
    pose = path.datum.pending
    assert pose is not None, "the start pose"
    valid_ns = _valid_ns(pose, stamp_ns, MAX_START_AHEAD_NS)
    waiting = pose if valid_ns > stamp_ns else None
    datum = replace(path.datum, pending=waiting, pending_ns=valid_ns)
    return replace(path, datum=datum, last=path.last.at_stamp(valid_ns))


def pose_applied(path: PathState, stamp_ns: int, model: RoverModel) -> tuple[PathState, bool]:
    """Return the path after a pair, with a pending pose applied if its stamp is reached.

    The second value tells whether the map is to be discarded.
    """
    datum = path.datum
    pose = datum.pending
    if pose is None:
        return path, False
    at_ns = datum.pending_ns
    if at_ns is None:
        at_ns = _valid_ns(pose, stamp_ns, MAX_AHEAD_NS)
    if at_ns > stamp_ns:
        return replace(path, datum=replace(datum, pending_ns=at_ns)), False
    path = replace(path, datum=replace(datum, pending=None, pending_ns=None))
    last_ns = path.history.last_ns
    is_far = last_ns is None or at_ns - last_ns > MAX_LATER_PERIODS * _shortest_period_ns(path)
    path = _reset(path, pose, at_ns, model) if is_far else _anchored(path, pose, at_ns, model)
    if last_ns is None or at_ns > last_ns:  # the present pair is kept or lost
        path = replace(path, errors=path.errors.kept(path.unobserved_of_left(stamp_ns, model)))
    return path, is_far


def pose_at(path: PathState, stamp_ns: int, model: RoverModel) -> Transform | None:
    """Return the pose of RB in DS to which an external pose with a stamp applies; None without a past pose."""
    if not path.history.poses:
        return None
    past, _ = path.history.at(stamp_ns)
    return path.datum.T_ds_world @ past.T_world_left @ model.T_left_rb


def _valid_ns(pose: StartPose, stamp_ns: int, max_ahead_ns: int) -> int:
    """Return the stamp at which a pose is valid, given the stamp of the newest pair."""
    stated_ns = pose.stamp_ns
    return stamp_ns if stated_ns is None or stated_ns > stamp_ns + max_ahead_ns else stated_ns


def _shortest_period_ns(path: PathState) -> int:
    """Return the shorter time between two pairs (`MAX_LATER_PERIODS`), ns."""
    motion_ns = path.last.motion_ns
    return path.period_ns if motion_ns is None else min(motion_ns, path.period_ns)


def _reset(path: PathState, pose: StartPose, stamp_ns: int | None, model: RoverModel) -> PathState:
    """Return the path whose last pose is an external pose, known at a stamp. The earlier path is discarded."""
    T_world_left = path.last.T_world_left
    T_ds_world, covariance = _with_external(T_world_left, pose, model)
    return replace(
        path,
        last=path.last.at_stamp(stamp_ns),
        datum=replace(path.datum, T_ds_world=T_ds_world, anchored_ns=None),
        errors=path.errors.reset(LocatedCovariance(T_world_left.translation, covariance)),
        history=History(),
    )


def _anchored(path: PathState, pose: StartPose, at_ns: int, model: RoverModel) -> PathState:
    """Return the path, moved in DS so that it passes through an external pose. Errors count from this pose on.

    The map is displaced relative to the external pose by the errors of the pair to which the pose applies, and by the
    unobserved motion between that pair and the stamp. If the stamp is later than the last accepted pair, the present
    pose is the external pose itself, and these errors count from the next accepted pair on.
    """
    past, apart_s = path.history.at(at_ns)
    last_ns = path.history.last_ns
    assert last_ns is not None, "without an accepted pair, the path is reset"
    T_ds_world, covariance = _with_external(past.T_world_left, pose, model)
    unobserved = model.covariance_at(past.T_world_left, unobserved_during(path.last.speed, apart_s, model))
    exact = LocatedCovariance(past.position, covariance)
    with_pair = LocatedCovariance(past.position, covariance + (unobserved + past.errors.this_pair))
    origin = Origin(
        external=exact if at_ns > last_ns else with_pair,
        external_of_next=with_pair,
        of_map=past.errors.of_map(past.position),
        sums=past.errors.sums,
    )
    errors = path.errors.anchored(origin, at_last_pair=past.stamp_ns == last_ns)
    return replace(path, datum=replace(path.datum, T_ds_world=T_ds_world, anchored_ns=at_ns), errors=errors)


def _with_external(T_world_left: Transform, pose: StartPose, model: RoverModel) -> tuple[Transform, FloatArray]:
    """Return the pose of the world in DS if an external pose is that of RB at a pose of the left camera in the world.

    The second value is the covariance `(6, 6)` of the external pose, for the left camera in the world.
    """
    T_ds_world = pose.T_ds_rb @ model.T_rb_left @ T_world_left.inverse()
    covariance = model.covariance_of_left(
        pose.covariance, R_world_frame=T_ds_world.rotation.T, R_world_left=T_world_left.rotation
    )
    return T_ds_world, covariance
