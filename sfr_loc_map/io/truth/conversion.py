"""Conversion of recorded true poses to the truth of RB.

A tracker measures its own body, such as a prism or an antenna, with its own clock. Only `truth_of_rb` converts poses of
this body to poses of RB. Positions without attitude remain those of the body; the score then evaluates the estimate at
the body.
"""

from __future__ import annotations

import logging
from collections.abc import Callable

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.plausibility import LOST_VARIANCE
from sfr_loc_map.geometry.rotation import quat_conjugate, quat_multiply, quat_rotate
from sfr_loc_map.geometry.trajectory import Truth
from sfr_loc_map.io.truth.config import DEFAULT_TRUTH, TrackedBodyConfig, with_lever_of
from sfr_loc_map.io.truth.pose_checks import check_poses
from sfr_loc_map.io.truth.recorded import RecordedTruth
from sfr_loc_map.message_stamps import NS_PER_S

_log = logging.getLogger(__name__)
UNIT_NORM = 1e-9  #: Deviation of a quaternion's norm from 1 that is attributed to rounding.


def truth_of_rb(
    recorded: RecordedTruth, config: TrackedBodyConfig = DEFAULT_TRUTH, warn: Callable[[str], object] = _log.warning
) -> Truth:
    """Return recorded poses as the truth of RB, without impossible poses; InputError if `config` does not fit.

    `warn` receives each warning about the poses; by default, the warnings are logged.
    """
    config = with_lever_of(config, recorded.T_rb_body)
    checked = check_poses(recorded, config.attitude, config.unknown, warn)
    poses = checked.recorded.poses
    variances = checked.recorded.variances
    if variances is None:
        variances = np.full((len(poses), 6), np.nan)
    has_attitude = poses.has_attitude
    positions = poses.positions
    quats = poses.quats_xyzw
    lever = np.array(config.lever_arm_m)
    if has_attitude and config.has_lever:
        quats = quat_multiply(_unit(quats), quat_conjugate(_unit(np.array(config.lever_quat_xyzw))))
        positions = positions - quat_rotate(quats, lever)
        lever = np.zeros(3)
    sigma_deg = float(np.degrees(sigma_of(variances[:, 3:]))) if has_attitude else 0.0
    return Truth(
        poses.stamps_ns + round(config.clock_offset_s * NS_PER_S),
        positions,
        quats,
        sigma_m=config.sigma_m or sigma_of(variances[:, :3]),
        sigma_deg=config.sigma_deg or sigma_deg,
        lever_arm_m=tuple(lever.tolist()),
        has_height=checked.has_height,
        has_tilt=checked.has_tilt or not has_attitude,
        read_from=recorded.read_from,
        declared=(*recorded.selected_by, *config.declared),
        findings=checked.findings,
    )


def _unit(quats_xyzw: FloatArray) -> FloatArray:
    """Return quaternions `(..., 4)` as unit quaternions; zeros, and norms of 1 within `UNIT_NORM`, are not changed."""
    norm = np.linalg.norm(quats_xyzw, axis=-1, keepdims=True)
    is_unit = (norm == 0.0) | (np.abs(norm - 1.0) <= UNIT_NORM)
    return np.asarray(quats_xyzw / np.where(is_unit, 1.0, norm))


def sigma_of(variances: FloatArray) -> float:
    """Return the median standard deviation per axis of messages with variances `(N, 3)`; 0: unknown."""
    known = variances[(variances > 0.0).all(axis=1) & (variances < LOST_VARIANCE).all(axis=1)]
    return float(np.sqrt(np.median(known.mean(axis=1)))) if len(known) else 0.0
