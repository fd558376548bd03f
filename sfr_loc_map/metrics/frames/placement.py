"""Frames of estimate and ground truth, and the reading of the specification by which they are compared.

An estimate is associated with the truth by its stamps. If the truth has no attitudes, the estimate is also aligned with
the true positions.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

import msgspec
import numpy as np

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.geometry.rotation import matrix_from_rotvec, quat_from_matrix, quat_multiply
from sfr_loc_map.geometry.trajectory import Trajectory, Truth, at_point
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.metrics import formulas
from sfr_loc_map.metrics.config import AssociationConfig, Condition, ConditionKind, Reading, TrajectoryScoreConfig
from sfr_loc_map.metrics.formulas import ErrorFunction, Lengths, Poses, SubTrajectoryErrors
from sfr_loc_map.metrics.frames.aligned_error import umeyama
from sfr_loc_map.metrics.frames.association import Estimates, Frames, associate
from sfr_loc_map.metrics.frames.truth_error import as_truth
from sfr_loc_map.metrics.table.records import Association

ERROR_FUNCTIONS: dict[Reading, ErrorFunction] = {
    Reading.POSE: formulas.pose_reading,
    Reading.DISPLACEMENT: formulas.displacement_reading,
    Reading.POSITION: formulas.position_reading,
}
"""The function that computes the errors by each reading of the requirements document; see `Reading`."""
MIN_TILT_DEG, TILT_GAIN = 0.1, 3.0
"""Smallest tilt of z, deg, and smallest reduction of the residual for which the complete rotation is fitted."""
ROLL_GAIN = 1.1  #: Smallest reduction of the residual for which a rotation about the line of the drive is fitted.


class Placement(NamedTuple):
    """The rotation, and the translation (m) after it, that align an estimate with the truth."""

    yaw_deg: float
    tilt_deg: float | None  #: Tilt of z; None if the rotation is a yaw.
    translation_m: tuple[float, ...]


class PlacedFrames(NamedTuple):
    """Frames, how they were associated, and the reading of the specification by which they are judged."""

    frames: Frames
    association: Association
    estimates: Estimates
    error_function: ErrorFunction
    placement: Placement | None
    poses: Poses  #: Poses of all frames; unknown true heights are NaN.
    length_m: Lengths  #: Length of the true path up to each frame.


def placed_frames(
    estimates: Estimates,
    truth: Trajectory,
    conditions: Sequence[Condition],
    config: TrajectoryScoreConfig,
    images_ns: IntArray | None = None,
) -> PlacedFrames:
    """Return the frames of an estimate and a truth. If the truth has no attitudes, the estimate is first aligned.

    Raises MetricsError if a condition requires true attitudes, but the truth has no roll and pitch.
    """
    known = as_truth(truth)
    has_turn = any(part.kind is ConditionKind.TURN for condition in conditions for part in condition.parts)
    if has_turn and not (truth.has_attitude and known.has_tilt):
        has = "no roll and pitch" if truth.has_attitude else "only positions"
        raise MetricsError(f"a condition turn=DEG requires true attitudes, but the truth has {has}: omit it")
    if truth.has_attitude:
        reading, placement = Reading(config.rebase), None
        frames, association = associate(estimates.trajectory, truth, config.association, images_ns)
        if not known.has_tilt:
            frames = with_estimated_tilt(frames)
        error_function = without_unknown_attitudes(known, ERROR_FUNCTIONS[reading])
    else:
        estimates, frames, association, placement = associate_positions(estimates, truth, config.association, images_ns)
        reading = Reading.YAW_ALIGNED if placement.tilt_deg is None else Reading.ROTATION_ALIGNED
        error_function = formulas.position_reading
    true_position = frames.true_position
    if not known.has_height:
        true_position = true_position.copy()
        true_position[:, 2] = np.nan
    poses = Poses(true_position, frames.true_attitude, frames.position, frames.attitude)
    length_m = formulas.path_length_m(frames.true_position)
    unknown = estimates.unknown_states(frames.estimate_rows)
    association = msgspec.structs.replace(
        association,
        lost=None if "lost" in unknown else int(np.count_nonzero(estimates.lost[frames.estimate_rows])),
        degraded=None if "degraded" in unknown else int(np.count_nonzero(estimates.degraded[frames.estimate_rows])),
        spacing_frames=config.spacing,
        rebase=reading,
        path_length_m=float(length_m[-1]) if len(length_m) else 0.0,
        duration_s=int(frames.stamps_ns[-1] - frames.stamps_ns[0]) / NS_PER_S if len(length_m) else None,
    )
    return PlacedFrames(frames, association, estimates, error_function, placement, poses, length_m)


def without_unknown_attitudes(truth: Truth, error_function: ErrorFunction) -> ErrorFunction:
    """Return a function whose attitude errors are unknown (NaN) if roll and pitch of the truth are unknown."""
    if truth.has_tilt:
        return error_function

    def without_attitude(poses: Poses, starts: IntArray, ends: IntArray) -> SubTrajectoryErrors:
        errors = error_function(poses, starts, ends)
        return errors._replace(attitude_deg=np.full_like(errors.attitude_deg, np.nan))

    return without_attitude


def with_estimated_tilt(frames: Frames) -> Frames:
    """Return frames whose true attitudes have the true heading, and the roll and pitch of the estimate.

    The estimate is then re-based at N only by the difference of the headings.
    """
    half_turn = 0.5 * (formulas.heading(frames.true_attitude) - formulas.heading(frames.attitude))
    zeros = np.zeros_like(half_turn)
    about_z = np.column_stack((zeros, zeros, np.sin(half_turn), np.cos(half_turn)))
    return frames._replace(true_attitude=quat_multiply(about_z, frames.attitude))


def associate_positions(
    estimates: Estimates, truth: Trajectory, config: AssociationConfig, images_ns: IntArray | None = None
) -> tuple[Estimates, Frames, Association, Placement]:
    """Return estimates of the point that the truth tracks, their frames, and the alignment with the truth.

    Yaw and translation are fitted by least squares, because neither vision nor gravity observes them (Zhang, Scaramuzza
    2018, section IV-B). A vision-only estimate that begins at the identity on a slope has a tilted z-axis. The complete
    rotation is therefore fitted if it tilts z and reduces the residual by `TILT_GAIN`.
    """
    poses = estimates.trajectory
    if isinstance(truth, Truth) and poses.has_attitude:
        poses = at_point(poses, truth.lever_arm_m)
    frames, association = associate(poses, truth, config, images_ns)
    turn, translation, tilt_deg = np.eye(3), np.zeros(3), None
    if len(frames.stamps_ns):
        middle, true_middle = frames.position.mean(axis=0), frames.true_position.mean(axis=0)
        estimated, true = frames.position - middle, frames.true_position - true_middle
        turn, tilt_deg = fitted_rotation(frames, estimated, true, has_height=as_truth(truth).has_height)
        translation = true_middle - turn @ middle
        attitude = quat_multiply(quat_from_matrix(turn), frames.attitude)
        frames = frames._replace(position=frames.position @ turn.T + translation, attitude=attitude)
    known = replace(estimates, trajectory=poses, covariance=None, steps=None)  # no covariance of aligned poses
    yaw_deg = float(np.degrees(np.arctan2(turn[1, 0], turn[0, 0])))
    return known, frames, association, Placement(yaw_deg, tilt_deg, tuple(translation.tolist()))


def fitted_rotation(
    frames: Frames, estimated: FloatArray, true: FloatArray, *, has_height: bool
) -> tuple[FloatArray, float | None]:
    """Return the rotation that aligns centred estimates `(F, 3)` with the truth, and the tilt of z, None for a yaw.

    Without true heights only a yaw is fitted.
    """
    (x, y), (u, v) = estimated.T[:2], true.T[:2]
    yaw = float(np.arctan2((x * v - y * u).sum(), (x * u + y * v).sum()))
    upright = matrix_from_rotvec(np.array([0.0, 0.0, yaw]))
    if not has_height:
        return upright, None
    # the smallest rotation that aligns the line of the estimates with the line of the truth
    to, _, of = np.linalg.svd(true.T @ estimated @ upright.T)
    across, cosine = np.cross(of[0], to[:, 0]), float(of[0] @ to[:, 0])
    sine = float(np.linalg.norm(across))
    found = [upright, matrix_from_rotvec(across * (np.arctan2(sine, cosine) / max(sine, 1e-12))) @ upright]
    with suppress(MetricsError):  # the rotation about a straight line is undetermined
        found.append(umeyama(frames.position, frames.true_position, with_scale=False).rotation)
    left = [float(np.linalg.norm(estimated @ each.T - true)) for each in found]
    best = 1 if left[1] <= ROLL_GAIN * left[-1] else -1
    tilt_deg = float(np.degrees(np.arccos(np.clip(found[best][2, 2], -1.0, 1.0))))
    if tilt_deg >= MIN_TILT_DEG and left[0] > TILT_GAIN * left[best]:
        return found[best], tilt_deg
    return upright, None
