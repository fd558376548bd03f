"""Poses, covariances and stamps from the numbers in the rows of a table."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray, Mask
from sfr_loc_map.geometry.plausibility import MAX_POSITION_M, plausible_poses, plausible_positions, plausible_rotations
from sfr_loc_map.geometry.rotation import quat_from_matrix
from sfr_loc_map.geometry.stereo import OPTICAL_IN_BODY
from sfr_loc_map.io.stamps.stamp_text import seconds_text
from sfr_loc_map.io.tables.pose_columns import COVARIANCES, MATRIX, QUATERNION, PoseColumns, TrajectoryFormat
from sfr_loc_map.io.tables.text_table import TableRows
from sfr_loc_map.message_stamps import NS_PER_S

MAX_NEGATIVE = 1e-6  #: Largest negative eigenvalue of a covariance by rounding, as a fraction of its largest variance.
CONJUGATED = np.array([-1.0, -1.0, -1.0, 1.0])
"""Signs that conjugate a quaternion, which converts `att_q_DsToRb` to the orientation in ROS messages and back."""

Values = Mapping[str, FloatArray]
"""The numbers `(N,)` of each column that is read, by its key."""


def values_by_key(rows: TableRows, columns: PoseColumns) -> Values:
    """Return the numbers in the rows of a table by their columns."""
    return dict(zip(columns.value_keys, rows.values.T, strict=True))


# ---- positions and quaternions


def poses_of(values: Values, columns: PoseColumns) -> tuple[FloatArray, FloatArray]:
    """Return positions `(N, 3)`, m, and quaternions `(N, 4)` as in ROS messages; zeros without attitudes.

    A quaternion is NaN if its matrix is not a rotation.
    """
    if columns.is_matrix:
        matrices = np.stack([values[key] for key in MATRIX], axis=1).reshape(-1, 3, 4)
        return _poses_of_matrices(matrices, is_optical=columns.format is TrajectoryFormat.KITTI)
    positions = np.stack([values[key] for key in columns.position_keys], axis=1) * np.array(columns.scales)
    quats = np.stack([values.get(key, np.zeros(len(positions))) for key in QUATERNION], axis=1)
    quats *= CONJUGATED if columns.is_conjugated else 1.0
    return positions, quats


def _poses_of_matrices(matrices: FloatArray, *, is_optical: bool) -> tuple[FloatArray, FloatArray]:
    """Return positions and quaternions of matrices `(N, 3, 4)`; a quaternion is NaN if its matrix is not a rotation.

    `is_optical`: both frames are rotated from optical axes (x right, y down, z forward) to those of the suite.
    """
    rotations, positions = matrices[:, :, :3], matrices[:, :, 3]
    is_rotation = plausible_rotations(rotations)
    rotations = np.where(is_rotation[:, None, None], rotations, np.eye(3))
    if is_optical:
        rotations = OPTICAL_IN_BODY @ rotations @ OPTICAL_IN_BODY.T
        positions = positions @ OPTICAL_IN_BODY.T
    quats = quat_from_matrix(rotations)
    return positions, np.where(is_rotation[:, None], quats, np.nan)


def checked_poses(positions: FloatArray, quats: FloatArray) -> tuple[Mask, list[str]]:
    """Return which poses are valid, `(N,)`, and the problem of each of the others."""
    is_valid, is_near = plausible_poses(positions, quats), plausible_positions(positions)
    problems = []
    for index in np.flatnonzero(~is_valid).tolist():
        problem = f"the quaternion {quats[index].tolist()} is not a rotation: a unit quaternion is required"
        if np.isnan(quats[index]).any():
            problem = "the matrix is not a pose: an orthonormal rotation is required"
        if not is_near[index]:
            problem = f"the position is implausible: at most {MAX_POSITION_M:g} m is allowed"
        problems.append(problem)
    return is_valid, problems


# ---- covariances


def covariances_of(values: Values) -> FloatArray:
    """Return covariances `(N, 6, 6)` in ROS order (position, attitude) from the columns of upper triangles."""
    covariances = np.zeros((len(next(iter(values.values()))), 6, 6))
    for prefix, (part, indices) in COVARIANCES.items():
        start = 0 if part == "position" else 3
        for index in indices:
            row, column = (start + int(digit) - 1 for digit in index)
            covariances[:, row, column] = covariances[:, column, row] = values[f"{prefix}{index}"]
    return covariances


def valid_covariances(covariances: FloatArray) -> tuple[FloatArray | None, int]:
    """Return covariances `(N, 6, 6)`, NaN where invalid (None if all are invalid), and the number that is invalid."""
    largest = np.diagonal(covariances, axis1=1, axis2=2).max(axis=1)
    is_valid = np.linalg.eigvalsh(covariances)[:, 0] >= -MAX_NEGATIVE * np.maximum(largest, 0.0)
    if not is_valid.any():
        return None, len(covariances)
    return np.where(is_valid[:, None, None], covariances, np.nan), int((~is_valid).sum())


# ---- stamps in two columns


def joined_stamps(rows: TableRows, fractions_ns: FloatArray) -> IntArray:
    """Return the stamps `(N,)`, ns, of rows with whole seconds in one column, and fractions, ns, in another.

    InputError if the seconds have decimals, or if a fraction is negative or at least 1 s.
    """
    if (has_decimals := rows.stamps_ns % NS_PER_S != 0).any():
        first = int(np.argmax(has_decimals))
        stamp = seconds_text(int(rows.stamps_ns[first]))
        raise InputError(
            f"{rows.name} line {rows.lines[first]}: the column of seconds contains {stamp}, although another column "
            f"contains the fraction of a second: whole seconds are required;",
            f"if {stamp} is the complete stamp, name only this column, as t",
        )
    if (is_outside := (fractions_ns < 0.0) | (fractions_ns >= NS_PER_S)).any():
        first = int(np.argmax(is_outside))
        raise InputError(
            f"{rows.name} line {rows.lines[first]}: the fraction of a second is {fractions_ns[first]:g} ns: 0 to "
            f"{NS_PER_S - 1} ns is required;",
            "name the column of the complete stamp as t, or correct the unit",
        )
    return rows.stamps_ns + np.rint(fractions_ns).astype(np.int64)
