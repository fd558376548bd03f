"""The path: motion, datum, history and accumulated errors, and how each kind of pair changes them.

A `Path` is a value. Each function takes a path and returns the next one; those that lead to a published pose return the
step to it, too.

| a pair | function |
|---|---|
| is the first one | `arrived` |
| was tracked | `tracked` |
| repeats the pair before, or contradicts its pose: the last pose is kept | `kept` |
| begins a new window at the last pose | `restarted` |
| became a keyframe, which was adjusted in the background | `adjusted` |
| is lost | `lost` |

Poses from outside: `given` when one arrives, `with_pending_pose` after each pair.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.camera import Pose
from sfr_loc_map.geometry.transform import Transform, propagated_covariance
from sfr_loc_map.inputs import NS_PER_S
from sfr_loc_map.localisation.backend.online_calibration import OnlineCalibration
from sfr_loc_map.localisation.backend.sliding_window import LandmarkMap
from sfr_loc_map.localisation.datum import MAX_AHEAD_NS, MAX_START_AHEAD_NS, Datum, History, PastPose, PendingPose
from sfr_loc_map.localisation.estimate import StartPose, StepEstimate
from sfr_loc_map.localisation.frontend.tracking import Tracks
from sfr_loc_map.localisation.motion_model import SLACK_M, SLACK_RAD, Motion, size_of
from sfr_loc_map.localisation.uncertainty import (
    MIN_VARIANCE,
    ZERO,
    DirectedError,
    DisparityBias,
    LocatedCovariance,
    PathErrors,
    RoverModel,
    Speed,
    StepMemory,
    StepMotion,
    drift_covariance,
    lens_turn_per_m,
    pose_noise,
    step_covariance,
    symmetric,
    systematic_step,
    unobserved_motion,
    updated_variance_factor,
)


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """The poses so far."""

    motion: Motion  #: Last known pose and its motion.
    datum: Datum  #: Place of the world in DS.
    errors: PathErrors  #: What the covariance of the pose is composed of.
    step: StepMemory  #: The pose published last.
    history: History = History()
    window: int = 0  #: Number of the present window.


class TrackedPair(NamedTuple):
    """A pair whose pose was accepted."""

    stamp_ns: int
    tracks: Tracks
    chi_median: float  #: Median squared Mahalanobis residual per degree of freedom; NaN without any.
    was_known: bool  #: Whether the pose of the pair before was not lost; it may have been kept.
    adds_unobserved: bool  #: Whether the covariance allows for the motion since the last pose.
    shear: float  #: Squared shear of the image rows over its variance.
    ambiguity: DirectedError | None  #: How far the pose may be another one; None if it is unambiguous.


def started(start: StartPose, model: RoverModel) -> Path:
    """Return the path before the first pair."""
    motion = Motion(Transform.identity(), Transform.identity(), None)
    errors = PathErrors(LocatedCovariance(np.zeros(3), ZERO))
    path = Path(motion, Datum(Transform.identity(), start), errors, StepMemory())
    return _placed(path, start, start.stamp_ns, model)


def arrived(path: Path, stamp_ns: int) -> Path:
    """Return the path at the first pair; later pairs change nothing.

    A start pose without a stamp holds at the first pair. A start pose with a later stamp is used from the first pair
    on, with the uncertainty that this causes, and is applied again at its own stamp.
    """
    if path.datum.has_pairs:
        return path
    datum = replace(path.datum, has_pairs=True)
    known_ns = path.motion.known_ns
    if known_ns is None or known_ns > stamp_ns + MAX_START_AHEAD_NS:
        return replace(path, datum=datum, motion=replace(path.motion, known_ns=stamp_ns))
    if known_ns > stamp_ns:
        datum = replace(datum, pending=PendingPose(datum.placed, MAX_START_AHEAD_NS))
    return replace(path, datum=datum)


# ---- poses from images


def tracked(
    path: Path, pair: TrackedPair, landmark_map: LandmarkMap, calibration: OnlineCalibration, model: RoverModel
) -> tuple[Path, StepEstimate]:
    """Return the path with the pose of a tracked pair, and the step to it."""
    stamp_ns = pair.stamp_ns
    now = Transform(*pair.tracks.pose)
    metres, radians = size_of(path.motion.T_world_left.inverse() @ now)
    unobserved = unobserved_motion(path.motion.speed, path.motion.unobserved_s(stamp_ns), model)
    ambiguity = pair.ambiguity
    if ambiguity is not None:  # at least the motion since the last pose, and what no image would show
        sigma_x, _, _, _, _, sigma_heading = np.sqrt(unobserved.diagonal())
        ambiguity = DirectedError(
            max(ambiguity.metres, metres, sigma_x), max(ambiguity.radians, radians, sigma_heading)
        )
    pose_only = np.asarray(np.linalg.inv(pair.tracks.information))
    errors = _tracked_errors(path, pair, ambiguity, pose_only, landmark_map, calibration, model)
    to_here = unobserved if pair.adds_unobserved else ZERO
    if ambiguity is not None:
        to_here = to_here + ambiguity.covariance
    factor = updated_variance_factor(path.step.variance_factor, pair.chi_median, model.sources)
    noise = pose_noise(pose_only, now.rotation, factor, pair.shear, model)
    memory = StepMemory(stamp_ns, now, to_here, noise, factor)
    motion = path.motion.tracked(stamp_ns, now, was_known=pair.was_known)

    depth_m = pair.tracks.landmarks.median_depth
    before_ns, before = _published(path, stamp_ns, now)
    seconds = (stamp_ns - before_ns) / NS_PER_S
    step = StepMotion.between(before, now, model)
    drift = landmark_map.window.drift
    estimate = StepEstimate(
        seconds=seconds,
        motion=step.vector,
        covariance=step_covariance(step, drift, pose_only, depth_m, factor, model) + path.step.unobserved + to_here,
        systematic=systematic_step(step, depth_m, calibration, model),
        noise=noise,
        noise_before=path.step.noise,
        unsteady=ZERO if pair.was_known else unobserved_motion(motion.speed, seconds, model),
    )
    history = path.history.with_pose(
        PastPose(
            stamp_ns=stamp_ns,
            T_world_left=now,
            was_known=pair.was_known,
            window=path.window,
            in_window=LocatedCovariance(now.translation, errors.in_window),
            bias=errors.bias,
            directed=errors.directed,
        )
    )
    return Path(motion, path.datum, errors, memory, history, path.window), estimate


def _tracked_errors(
    path: Path,
    pair: TrackedPair,
    ambiguity: DirectedError | None,
    pose_only: FloatArray,
    landmark_map: LandmarkMap,
    calibration: OnlineCalibration,
    model: RoverModel,
) -> PathErrors:
    """Return the accumulated errors of a tracked pose."""
    errors = path.errors
    last = path.motion.T_world_left
    position = pair.tracks.pose.position
    metres, _ = size_of(last.inverse() @ Transform(*pair.tracks.pose))
    errors = errors.with_directed(DirectedError(0.0, lens_turn_per_m(calibration, model) * metres), position)
    if ambiguity is not None:
        errors = errors.with_directed(ambiguity, position)
    depth_m = landmark_map.landmarks.median_depth
    per_px = (position - last.translation) * depth_m / model.focal_baseline
    bias = DisparityBias(errors.bias.total + per_px, errors.bias.corrected + per_px * calibration.corrected_px)
    return replace(
        errors,
        in_window=pose_only + landmark_map.window.covariance,
        unobserved=_unobserved_of_left(path, pair.stamp_ns, model) if pair.adds_unobserved else ZERO,
        bias=bias,
    )


def kept(path: Path, stamp_ns: int, model: RoverModel) -> tuple[Path, StepEstimate]:
    """Return the path with the last pose kept up to a stamp, and the step; the rover may stand still or have moved."""
    errors = replace(path.errors, unobserved=_unobserved_of_left(path, stamp_ns, model))
    memory, step = _step_to_same_pose(path, stamp_ns, model)
    return replace(path, errors=errors, step=memory), step


def restarted(path: Path, stamp_ns: int, landmark_map: LandmarkMap, model: RoverModel) -> tuple[Path, StepEstimate]:
    """Return the path with a new window that begins at the last pose, and the step to it."""
    position = path.motion.T_world_left.translation
    depth_m = landmark_map.landmarks.median_depth
    known = drift_covariance(path.errors, position, model) + _unobserved_of_left(path, stamp_ns, model)
    blur_rad = model.sources.blur_px / model.fx
    of_first_image = DirectedError(blur_rad * depth_m, blur_rad).covariance
    in_window = landmark_map.window.covariance
    errors = replace(
        path.errors,
        start=LocatedCovariance(position, known + of_first_image),
        reference=None,
        in_window=in_window,
        unobserved=ZERO,
    )
    memory, step = _step_to_same_pose(path, stamp_ns, model)
    window = path.window + 1
    past = PastPose(
        stamp_ns=stamp_ns,
        T_world_left=path.motion.T_world_left,
        was_known=False,
        window=window,
        in_window=LocatedCovariance(position, in_window),
        bias=errors.bias,
        directed=errors.directed,
    )
    motion = path.motion.restarted(stamp_ns)
    return Path(motion, path.datum, errors, memory, path.history.with_pose(past), window), step


def lost(path: Path) -> Path:
    """Return the path after a lost pair."""
    return replace(path, motion=path.motion.without_prediction())


def adjusted(path: Path, pose: Pose, covariance: FloatArray, *, has_yaw_step: bool) -> Path | None:
    """Return the path that continues from the adjusted pose of the last pair; None if the adjustment diverged.

    A change of the yaw correction moves the pose. The covariance of the next step grows by the square of this motion.
    """
    if not (np.isfinite(np.column_stack(pose)).all() and np.isfinite(covariance).all()):
        return None
    T_world_left = Transform(*pose)
    metres, radians = size_of(path.motion.T_world_left.inverse() @ T_world_left)
    if not (metres <= SLACK_M and radians <= SLACK_RAD):
        return None
    step = path.step
    if has_yaw_step:
        step = replace(step, unobserved=step.unobserved + DirectedError(metres, radians).covariance)
    return replace(
        path,
        motion=replace(path.motion, T_world_left=T_world_left),
        errors=replace(path.errors, in_window=covariance, unobserved=ZERO),
        step=step,
    )


def _published(path: Path, stamp_ns: int, now: Transform) -> tuple[int, Transform]:
    """Return stamp and pose published last; the present ones before the first."""
    if path.step.stamp_ns is None or path.step.T_world_left is None:
        return stamp_ns, now
    return path.step.stamp_ns, path.step.T_world_left


def _unobserved_of_left(path: Path, stamp_ns: int, model: RoverModel) -> FloatArray:
    """Return the covariance of the left camera in the world of a motion up to a stamp that no image showed."""
    rotation = path.motion.T_world_left.rotation
    of_rb = unobserved_motion(path.motion.speed, path.motion.unobserved_s(stamp_ns), model)
    return model.covariance_of_left(of_rb, rotation @ model.T_rb_left.rotation.T, rotation)


def _step_to_same_pose(path: Path, stamp_ns: int, model: RoverModel) -> tuple[StepMemory, StepEstimate]:
    """Return the step to a pose that stays. Only the growth of the unobserved motion since the last step is added."""
    before = path.step
    seconds = 0.0 if before.stamp_ns is None else (stamp_ns - before.stamp_ns) / NS_PER_S
    speed = path.motion.speed
    unobserved = unobserved_motion(speed, path.motion.unobserved_s(stamp_ns), model)
    growth = np.maximum(unobserved - before.unobserved, unobserved_motion(speed, seconds, model))
    covariance = growth + MIN_VARIANCE * np.eye(6)
    memory = replace(before, stamp_ns=stamp_ns, T_world_left=path.motion.T_world_left, unobserved=unobserved)
    step = StepEstimate(seconds, np.zeros(6), covariance, np.zeros(6), before.noise, before.noise, ZERO)
    return memory, step


# ---- poses from outside


def given(path: Path, pose: StartPose, model: RoverModel) -> Path:
    """Return the path with a pose from outside, which is applied with the pair at or after its stamp."""
    if not path.datum.has_pairs:
        return _placed(path, pose, pose.stamp_ns, model)
    return replace(path, datum=replace(path.datum, pending=PendingPose(pose, MAX_AHEAD_NS)))


def with_pending_pose(path: Path, stamp_ns: int, model: RoverModel) -> tuple[Path, bool]:
    """Apply the pending pose after the pair of a stamp; return whether the map is to be forgotten.

    It is forgotten if no pair was seen since the pose's stamp: the map says nothing about the place of that pose.
    """
    pending = path.datum.pending
    if pending is None:
        return path, False
    at_ns = pending.stamp_at(stamp_ns)
    if at_ns > stamp_ns:
        return path, False
    path = replace(path, datum=replace(path.datum, pending=None))
    last_ns = path.history.last_ns
    if last_ns is None or at_ns > last_ns:
        return _placed(path, pending.pose, at_ns, model), True
    return _rebased(path, pending.pose, at_ns, model), False


def _placed(path: Path, pose: StartPose, stamp_ns: int | None, model: RoverModel) -> Path:
    """Return the path whose last pose is a pose from outside, known at a stamp. The path so far is forgotten."""
    last = path.motion.T_world_left
    T_ds_world = pose.T_ds_rb @ model.T_rb_left @ last.inverse()
    covariance = model.covariance_of_left(pose.covariance, T_ds_world.rotation.T, last.rotation)
    bias = path.errors.bias
    return replace(
        path,
        motion=replace(path.motion, known_ns=stamp_ns, speed=Speed(0.0, 0.0)),
        datum=replace(path.datum, T_ds_world=T_ds_world, placed=pose),
        errors=PathErrors(
            start=LocatedCovariance(last.translation, covariance),
            bias=bias,
            bias_at_start=bias,
            located=LocatedCovariance(last.translation, ZERO),
        ),
        history=History(),
    )


def _rebased(path: Path, pose: StartPose, at_ns: int, model: RoverModel) -> Path:
    """Return the path that passes through a pose from outside at a stamp of the past; errors count from there."""
    past, apart_s = path.history.at(at_ns)
    T_ds_world = pose.T_ds_rb @ model.T_rb_left @ past.T_world_left.inverse()
    unobserved = unobserved_motion(path.motion.speed, apart_s, model)
    unobserved = symmetric(propagated_covariance(unobserved, np.zeros(3), pose.T_ds_rb.rotation))
    covariance = model.covariance_of_left(
        pose.covariance + unobserved, T_ds_world.rotation.T, past.T_world_left.rotation
    )
    position = past.in_window.position
    since = path.errors.directed.since(past.directed)
    if past.window == path.window:
        start = LocatedCovariance(position, covariance)
        reference = past.in_window
    else:  # the start of the present window holds what no image showed between the windows
        window_start = path.errors.start
        at_window = propagated_covariance(covariance, window_start.position - position)
        start = LocatedCovariance(window_start.position, window_start.covariance + at_window)
        reference = None
    errors = replace(
        path.errors,
        start=start,
        reference=reference,
        bias_at_start=past.bias,
        directed=since,
        located=LocatedCovariance(position, since.covariance),
    )
    return replace(path, datum=replace(path.datum, T_ds_world=T_ds_world), errors=errors)
