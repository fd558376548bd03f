"""External poses of RB in DS: the start of the run, and poses that are set later. One of them defines the datum.

`given` accepts a pose, and a later pose replaces a pose that is not applied yet. A pose applies at its stamp:

| pose | applies at |
|---|---|
| without a stamp | the next pair, even if that pair is refused |
| start pose up to `MAX_START_AHEAD_NS` after the first pair | the first pair, and again its stamp if it is later |
| pose set later, up to `MAX_AHEAD_NS` after the next pair | its stamp |
| with a still later stamp, which indicates a different clock | the next pair |

The first pair fixes the stamp of the start pose before the pair is processed (`at_first_pair`). After each pair,
`applied` applies a pose that was set later and whose stamp is reached. The guards have then decided on the pair, and an
external pose does not change their decision. Where the pose applies, and what becomes of the map, depends on its stamp:

| stamp | function | pose to which the external pose applies | map |
|---|---|---|---|
| before or at the last accepted pair | `_rebased` | that of the pair or between two pairs (`History.at`) | kept |
| up to `MAX_LATER_PERIODS` later | `_rebased` | that of the last accepted pair | kept |
| still later, or before the first accepted pair | `_placed` | the last known pose | discarded |

A pair that began a window counts as accepted here. In the second row, the unobserved motion from the last accepted pair
to the stamp counts from the next accepted pair on (`Origin.of_accepted`). In the third row, the position of the
external pose in the map is unknown. The map is therefore discarded, and the motion from the stamp to the pair is
unobserved.
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
from sfr_loc_map.localisation.uncertainty.path_errors import NOTHING, LocatedCovariance, Origin, PathErrors
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
    path = PathState(last, Datum(Transform.identity()), PathErrors(Origin(NOTHING)), PublishedPose())
    return given(path, start, model)


def given(path: PathState, pose: StartPose, model: RoverModel) -> PathState:
    """Return the path with an external pose, which waits for its stamp. Before the first pair, it is the start pose."""
    path = replace(path, datum=replace(path.datum, pending=pose, pending_ns=None))
    return _placed(path, pose, pose.stamp_ns, model) if path.arrived_ns is None else path


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


def applied(path: PathState, stamp_ns: int, model: RoverModel) -> tuple[PathState, bool]:
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
    discards_map = last_ns is None or at_ns - last_ns > MAX_LATER_PERIODS * _shortest_period_ns(path)
    path = _placed(path, pose, at_ns, model) if discards_map else _rebased(path, pose, at_ns, model)
    if last_ns is None or at_ns > last_ns:  # the present pair is kept or lost
        path = replace(path, errors=path.errors.kept(path.unobserved_of_left(stamp_ns, model)))
    return path, discards_map


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


def _placed(path: PathState, pose: StartPose, stamp_ns: int | None, model: RoverModel) -> PathState:
    """Return the path whose last pose is an external pose, known at a stamp. The earlier path is discarded."""
    T_world_left = path.last.T_world_left
    T_ds_world, covariance = _with_external(T_world_left, pose, model)
    return replace(
        path,
        last=path.last.at_stamp(stamp_ns),
        datum=replace(path.datum, T_ds_world=T_ds_world, rebased_ns=None),
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
