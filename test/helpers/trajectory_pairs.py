"""Ten pairs of trajectories that differ in length, rate, gaps, stamps, scale and place; no random numbers."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sfr_loc_map.geometry.rotation import matrix_from_rotvec, quat_from_matrix, quat_multiply, quat_rotate
from sfr_loc_map.geometry.trajectory import Trajectory

START_NS = 1_700_000_000_000_000_000
MS = 1_000_000


def path(seconds: np.ndarray) -> Trajectory:
    """Return a winding drive at these seconds after the start."""
    positions = np.column_stack((0.5 * seconds, 3 * np.sin(0.2 * seconds), 0.3 * np.cos(0.13 * seconds)))
    angles = np.column_stack((0.05 * np.sin(seconds), 0.04 * np.cos(0.7 * seconds), 0.6 * np.sin(0.2 * seconds)))
    quats = np.array([quat_from_matrix(matrix_from_rotvec(row)) for row in angles])
    return Trajectory(START_NS + np.round(seconds * 1e9).astype(np.int64), positions, quats)


def drifted(truth: Trajectory, size: float, scale: float = 1.0, shift_ns: int = 0) -> Trajectory:
    """Return an estimate that drifts from the truth, in a world frame of its own."""
    seconds = (truth.stamps_ns - START_NS) * 1e-9
    wobble = np.column_stack((np.sin(1.7 * seconds), np.cos(2.3 * seconds), np.sin(3.1 * seconds + 1)))
    positions = truth.positions + size * (wobble + 0.02 * seconds[:, None] * [1.0, -0.5, 0.2])
    turn = np.array([quat_from_matrix(matrix_from_rotvec(row)) for row in 0.3 * size * wobble])
    world = quat_from_matrix(matrix_from_rotvec([0.1, -0.2, 0.7]))
    positions = scale * quat_rotate(world, positions) + [3.0, -2.0, 0.5]
    return Trajectory(
        truth.stamps_ns + shift_ns, positions, quat_multiply(world, quat_multiply(truth.quats_xyzw, turn))
    )


def some(poses: Trajectory, rows: np.ndarray) -> Trajectory:
    return Trajectory(poses.stamps_ns[rows], poses.positions[rows], poses.quats_xyzw[rows])


def _jitter(poses: Trajectory, size_ns: float) -> Trajectory:
    shifts = np.round(size_ns * np.sin(np.arange(len(poses)) * 2.1)).astype(np.int64)
    return Trajectory(poses.stamps_ns + shifts, poses.positions, poses.quats_xyzw)


def _rounded(poses: Trajectory) -> Trajectory:
    return Trajectory(poses.stamps_ns, np.round(poses.positions, 4), np.round(poses.quats_xyzw, 6))


def _far(poses: Trajectory) -> Trajectory:
    offset = np.array([21_000.0, -4_000.0, 300.0])
    return Trajectory(poses.stamps_ns, poses.positions + offset, poses.quats_xyzw)


TENTHS, FINE = path(np.arange(120) * 0.1), path(np.arange(400) * 0.05)
COARSE = path(np.arange(60) / 3.0)
PAIRS: dict[str, Callable[[], tuple[Trajectory, Trajectory]]] = {
    "same_stamps": lambda: (drifted(TENTHS, 0.05), TENTHS),
    "truth_twice_as_often": lambda: (drifted(TENTHS, 0.02), FINE),
    "estimate_more_often": lambda: (drifted(FINE, 0.1), TENTHS),
    "stamps_3_ms_late": lambda: (drifted(TENTHS, 0.05, shift_ns=3 * MS), FINE),
    "stamps_jitter": lambda: (_jitter(drifted(TENTHS, 0.03), 7.3 * MS), TENTHS),
    "gaps": lambda: (some(drifted(FINE, 0.04), np.r_[0:50, 120:180, 300:400]), some(FINE, np.r_[20:350])),
    "five_poses": lambda: (some(drifted(TENTHS, 0.2), np.arange(0, 50, 10)), TENTHS),
    "scale_1.3": lambda: (drifted(FINE, 0.05, scale=1.3), FINE),
    "rounded_numbers": lambda: (_rounded(drifted(COARSE, 0.05)), _rounded(COARSE)),
    "far_from_the_origin": lambda: (_far(drifted(COARSE, 0.05)), _far(COARSE)),
}
