"""Stamps with an estimate and a true pose, and the reading of the specification by which both poses are compared.

An estimate is associated with the truth by its stamps. If the truth has no attitudes, the estimate is also aligned with
the true positions.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray, Mask
from sfr_loc_map.geometry.rotation import matrix_from_rotvec, quat_from_matrix, quat_multiply
from sfr_loc_map.geometry.trajectory import Trajectory, Truth, as_truth, at_point
from sfr_loc_map.metrics import formulas
from sfr_loc_map.metrics.conditions import Condition, ConditionKind
from sfr_loc_map.metrics.config import AssociationConfig, Reading, TrajectoryScoreConfig
from sfr_loc_map.metrics.formulas import ErrorFunction, Lengths, Poses
from sfr_loc_map.metrics.frames.association import (
    Estimates,
    Frames,
    MatchedStamps,
    StateCounts,
    associate,
    check_attitudes,
)
from sfr_loc_map.metrics.frames.true_attitudes import check_true_attitudes, known_attitudes
from sfr_loc_map.metrics.frames.umeyama import umeyama
from sfr_loc_map.metrics.sub_trajectories import SubTrajectories

ERROR_FUNCTIONS: dict[Reading, ErrorFunction] = {
    Reading.POSE: formulas.pose_reading,
    Reading.DISPLACEMENT: formulas.displacement_reading,
    Reading.POSITION: formulas.position_reading,
    Reading.YAW_ALIGNED: formulas.position_reading,
    Reading.ROTATION_ALIGNED: formulas.position_reading,
}
"""The function that computes the errors by each reading of the requirements document; see `Reading`."""
MIN_TILT_DEG, TILT_GAIN = 0.1, 3.0
"""Smallest tilt of z, deg, and smallest factor of the reduction of the residual, for which the complete rotation is
fitted. Chosen by hand: the drift of an upright estimate reaches this factor in one of a thousand random drives
(test/metrics/test_truth_score.py)."""
ROLL_GAIN = 1.1
"""Smallest factor of the reduction of the residual for which a rotation about the path is fitted. Chosen by hand: the
residual of a nearly straight path hardly depends on this rotation."""


class Placement(NamedTuple):
    """The rotation, and the translation (m) after it, that align an estimate with the truth."""

    yaw_deg: float
    tilt_deg: float | None  #: Tilt of z; None if the rotation is a yaw.
    translation_m: tuple[float, ...]

    @property
    def reading(self) -> Reading:
        """The reading of the specification for an estimate with this alignment."""
        return Reading.YAW_ALIGNED if self.tilt_deg is None else Reading.ROTATION_ALIGNED


class PlacedFrames(NamedTuple):
    """Stamps with an estimate and a true pose in common axes, and the reading of the specification that judges them.

    If the truth has no heights (`truth.has_height`), its heights are 0, so that lengths are horizontal.
    """

    frames: Frames
    matched: MatchedStamps
    estimates: Estimates
    truth: Truth
    configured_reading: Reading  #: Reading of the setting `rebase`, which judges estimates that were not aligned.
    placement: Placement | None  #: The alignment with a truth without attitudes; None for other truths.
    length_m: Lengths  #: Length of the true path up to each frame.

    @property
    def reading(self) -> Reading:
        """The reading of the specification by which limits are judged."""
        return self.configured_reading if self.placement is None else self.placement.reading

    @property
    def poses(self) -> Poses:
        """The poses of all frames, by which errors are computed; unknown true heights are NaN, as are their errors."""
        true_position = self.frames.true_position
        if not self.truth.has_height:
            true_position = true_position * [1.0, 1.0, np.nan]
        return Poses(true_position, self.frames.true_attitude, self.frames.position, self.frames.attitude)

    @property
    def states(self) -> StateCounts:
        """Numbers of the frames whose pose is lost or degraded."""
        return self.estimates.state_counts(self.frames.estimate_rows)

    @property
    def is_reported(self) -> Mask:
        """Whether the pose of each frame `(F,)` is reported as lost or degraded."""
        return self.estimates.unreliable[self.frames.estimate_rows]

    @property
    def readings(self) -> list[Reading]:
        """The readings by which errors are known, the judged one first."""
        if self.placement is not None:
            return [self.reading]
        others = [reading for reading in Reading if not reading.is_fit and reading is not self.reading]
        return [self.reading, *others]

    def sub_trajectories(self, starts: IntArray, ends: IntArray, reading: Reading | None = None) -> SubTrajectories:
        """Return sub-trajectories and their errors, by the judged reading or by another reading.

        Attitude errors are unknown (NaN) if roll and pitch of the truth are unknown.
        """
        poses = self.poses
        errors = ERROR_FUNCTIONS[reading or self.reading](poses, starts, ends)
        if not self.truth.has_tilt:
            errors = errors._replace(attitude_deg=np.full_like(errors.attitude_deg, np.nan))
        return SubTrajectories(starts, ends, poses, errors)


def placed_frames(
    estimates: Estimates,
    trajectory: Trajectory,
    conditions: Sequence[Condition],
    config: TrajectoryScoreConfig,
    images_ns: IntArray | None = None,
) -> PlacedFrames:
    """Return the frames of an estimate and a true trajectory.

    If the truth has no attitudes, the estimate is first aligned. MetricsError if a condition requires true attitudes,
    but the truth has no roll and pitch, or if the estimate has no attitudes.
    """
    truth = as_truth(trajectory)
    if any(each.kind is ConditionKind.TURN for condition in conditions for each in condition.components):
        check_true_attitudes(truth, "a condition turn=DEG", "omit it")
    if truth.has_attitude:
        placement = None
        frames, matched = associate(estimates.trajectory, truth, config.association, images_ns)
        frames = frames._replace(true_attitude=known_attitudes(truth, frames.true_attitude, frames.attitude))
    else:
        estimates, frames, matched, placement = associate_positions(estimates, truth, config.association, images_ns)
    return PlacedFrames(
        frames=frames,
        matched=matched,
        estimates=estimates,
        truth=truth,
        configured_reading=Reading(config.rebase),
        placement=placement,
        length_m=formulas.path_length_m(frames.true_position),
    )


def associate_positions(
    estimates: Estimates, truth: Truth, config: AssociationConfig, images_ns: IntArray | None = None
) -> tuple[Estimates, Frames, MatchedStamps, Placement]:
    """Return estimates of the point that the truth tracks, their frames, and the alignment with the truth.

    Yaw and translation are fitted by least squares, because neither vision nor gravity observes them (Zhang, Scaramuzza
    2018, section IV-B). A vision-only estimate that begins at the identity on a slope has a tilted z-axis. The complete
    rotation is therefore fitted if it tilts z and reduces the residual by `TILT_GAIN`. MetricsError if the estimate has
    no attitudes.
    """
    check_attitudes(estimates.trajectory)
    poses = at_point(estimates.trajectory, truth.lever_arm_m)
    frames, matched = associate(poses, truth, config, images_ns)
    turn, translation, tilt_deg = np.eye(3), np.zeros(3), None
    if len(frames.stamps_ns):
        middle, true_middle = frames.position.mean(axis=0), frames.true_position.mean(axis=0)
        estimated, true = frames.position - middle, frames.true_position - true_middle
        turn, tilt_deg = fitted_rotation(frames, estimated, true, has_height=truth.has_height)
        translation = true_middle - turn @ middle
        attitude = quat_multiply(quat_from_matrix(turn), frames.attitude)
        frames = frames._replace(position=frames.position @ turn.T + translation, attitude=attitude)
    known = replace(estimates, trajectory=poses, covariance=None, steps=None)  # neither applies to the aligned poses
    yaw_deg = float(np.degrees(np.arctan2(turn[1, 0], turn[0, 0])))
    return known, frames, matched, Placement(yaw_deg, tilt_deg, tuple(translation.tolist()))


def fitted_rotation(
    frames: Frames, estimated: FloatArray, true: FloatArray, *, has_height: bool
) -> tuple[FloatArray, float | None]:
    """Return the rotation that aligns centred estimates `(F, 3)` with the truth, and the tilt of z, None for a yaw.

    Three rotations are fitted: a yaw, the yaw with the smallest tilt that aligns the principal directions of the paths,
    and the complete rotation. The complete rotation is preferred to the yaw with the tilt if it reduces the
    residual by `ROLL_GAIN`, because the roll about a nearly straight path is undetermined. Without true heights only a
    yaw is fitted.
    """
    x, y, _ = estimated.T
    true_x, true_y, _ = true.T
    sine = (x * true_y - y * true_x).sum()
    cosine = (x * true_x + y * true_y).sum()
    upright = matrix_from_rotvec(np.array([0.0, 0.0, float(np.arctan2(sine, cosine))]))
    if not has_height:
        return upright, None
    true_directions, _, directions = np.linalg.svd(true.T @ estimated @ upright.T)
    along_line = smallest_rotation(directions[0], true_directions[:, 0]) @ upright
    complete = along_line
    with suppress(MetricsError):  # the rotation about a straight line is undetermined
        complete = umeyama(frames.position, frames.true_position, with_scale=False).rotation
    upright_m, along_line_m, complete_m = (
        float(np.linalg.norm(estimated @ rotation.T - true)) for rotation in (upright, along_line, complete)
    )
    tilted, tilted_m = (along_line, along_line_m) if along_line_m <= ROLL_GAIN * complete_m else (complete, complete_m)
    tilt_deg = float(np.degrees(np.arccos(np.clip(tilted[2, 2], -1.0, 1.0))))
    if tilt_deg >= MIN_TILT_DEG and upright_m > TILT_GAIN * tilted_m:
        return tilted, tilt_deg
    return upright, None


def smallest_rotation(direction: FloatArray, target: FloatArray) -> FloatArray:
    """Return the matrix of the smallest rotation from one unit vector `(3,)` to another."""
    axis = np.cross(direction, target)
    sine = float(np.linalg.norm(axis))
    angle = np.arctan2(sine, float(direction @ target))
    return matrix_from_rotvec(axis * (angle / max(sine, 1e-12)))
