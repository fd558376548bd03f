"""Rigid transforms, and the propagation of pose covariances."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite

import numpy as np
from numpy.typing import ArrayLike

from sfr_loc_map.errors import GeometryError
from sfr_loc_map.geometry.arrays import FloatArray, as_numbers, kind_of
from sfr_loc_map.geometry.plausibility import MAX_POSITION_M, QUATERNION_SQUARES, plausible_rotations
from sfr_loc_map.geometry.rotation import (
    matrix_from_quat,
    matrix_from_rotvec,
    quat_conjugate,
    quat_from_matrix,
    rotvec_from_matrix,
)

NO_ROTATION = np.eye(3)
"""Rotation between frames with parallel axes."""
LAST_ROW = np.array([0.0, 0.0, 0.0, 1.0])  #: Last row of a homogeneous matrix.
LAST_ROW_TOLERANCE = 1e-6  #: Largest deviation of a number of the last row from `LAST_ROW`: products are rounded.


@dataclass(frozen=True, slots=True, eq=False)
class Transform:
    """Rigid transform `T_a_b`: takes points in frame b to frame a.

    `from_matrix` and `from_quat` accept external numbers, and therefore check that the rotation is valid. The
    constructor omits this check, because products and inverses of rotations are rotations.
    """

    rotation: FloatArray  #: `(3, 3)` float64, det +1, takes components in b to a.
    translation: FloatArray  #: `(3,)` float64, metres, the origin of b in a.
    #: `(4,)` float64, the argument of `from_quat`, None otherwise. No calculation uses this quaternion: it only
    #: preserves the digits of a file when the pose is written again (`file_quat_xyzw`).
    given_quat_xyzw: FloatArray | None = None

    def __post_init__(self) -> None:
        """Check shapes and values; GeometryError if a number is not finite or a coordinate exceeds `MAX_POSITION_M`."""
        rotation_shape = getattr(self.rotation, "shape", None)
        if rotation_shape != (3, 3) or getattr(self.translation, "shape", None) != (3,):
            raise GeometryError(
                f"a transform has the rotation {kind_of(self.rotation)} and the translation "
                f"{kind_of(self.translation)}: arrays (3, 3) and (3,) are required"
            )
        position = self.translation.tolist()  # Python loops are faster than numpy for so few numbers
        numbers = (*position, *self.rotation.reshape(-1).tolist())
        if not all(map(isfinite, numbers)):
            raise GeometryError("a transform contains a non-finite number: finite numbers are required")
        if max(map(abs, position)) > MAX_POSITION_M:
            raise GeometryError(f"a position is {self.translation.tolist()} m: at most {MAX_POSITION_M:g} m is allowed")

    @classmethod
    def identity(cls) -> Transform:
        """Return the identity transform."""
        return cls(np.eye(3), np.zeros(3))

    @classmethod
    def from_quat(cls, translation: ArrayLike, quat_xyzw: ArrayLike) -> Transform:
        """Return `T_a_b` from the position, metres, and the orientation of b in a, as in ROS messages.

        The quaternion takes components in b to a. A norm that is not within 1 +- 0.01 raises GeometryError; other
        quaternions are normalised.
        """
        quat = as_numbers("quat_xyzw", quat_xyzw)
        low, high = QUATERNION_SQUARES
        if quat.shape != (4,) or not low <= sum(value * value for value in quat.tolist()) <= high:
            raise GeometryError(f"the quaternion {quat.tolist()} is not a rotation: a unit quaternion is required")
        return cls(matrix_from_quat(quat), as_numbers("translation", translation), quat)

    @classmethod
    def from_matrix(cls, matrix: ArrayLike) -> Transform:
        """Return `T_a_b` from a matrix `(3, 4)` or `(4, 4)`.

        GeometryError if the shape, the rotation or the last row is invalid.
        """
        matrix = as_numbers("matrix", matrix)
        if matrix.shape not in ((3, 4), (4, 4)):
            raise GeometryError(f"a matrix has the shape {matrix.shape}: (3, 4) or (4, 4) is required")
        if not plausible_rotations(matrix[:3, :3]):
            raise GeometryError("a matrix is not a rotation: an orthonormal matrix with determinant +1 is required")
        if len(matrix) == 4 and not np.abs(matrix[3] - LAST_ROW).max() <= LAST_ROW_TOLERANCE:
            raise GeometryError(
                f"the last row of a matrix is {matrix[3].tolist()}: 0, 0, 0, 1 is required; is the matrix transposed?"
            )
        return cls(matrix[:3, :3].copy(), matrix[:3, 3].copy())

    @classmethod
    def from_origin_and_attitude(cls, origin: ArrayLike, att_q: ArrayLike) -> Transform:
        """Return `T_a_b` from `bOriginPos_m_A` and `att_q_AToB` [3.1.2], the conjugate of the orientation in ROS.

        GeometryError as for `from_quat`.
        """
        quat = as_numbers("att_q", att_q)
        return cls.from_quat(origin, quat_conjugate(quat) if quat.shape == (4,) else quat)

    @property
    def quat_xyzw(self) -> FloatArray:
        """Orientation of b in a `(4,)`, scalar last and >= 0, as in ROS messages."""
        return quat_from_matrix(self.rotation)

    @property
    def file_quat_xyzw(self) -> FloatArray:
        """Orientation of b in a `(4,)` for files and messages: `given_quat_xyzw` if set, otherwise `quat_xyzw`."""
        return self.quat_xyzw if self.given_quat_xyzw is None else self.given_quat_xyzw

    @property
    def matrix(self) -> FloatArray:
        """Homogeneous matrix `(4, 4)`."""
        matrix = np.eye(4)
        matrix[:3, :3] = self.rotation
        matrix[:3, 3] = self.translation
        return matrix

    def inverse(self) -> Transform:
        """Return `T_b_a`."""
        return Transform(self.rotation.T.copy(), -self.rotation.T.dot(self.translation))

    def __matmul__(self, other: Transform) -> Transform:
        """Return `T_a_c = T_a_b @ T_b_c`."""
        # `dot` is faster than `@` for small matrices
        return Transform(self.rotation.dot(other.rotation), self.rotation.dot(other.translation) + self.translation)

    def apply(self, points: ArrayLike) -> FloatArray:
        """Return points `(..., 3)` of frame b, metres, in frame a."""
        return np.asarray(np.asarray(points, dtype=np.float64) @ self.rotation.T + self.translation)


def propagation(displacement: FloatArray) -> FloatArray:
    """Return the Jacobian F `(6, 6)`, in ROS order, from the error of a pose to that of a rigidly attached pose.

    A rotation error w about the axes of the fixed frame moves a pose at the displacement d by `w x d`.
    """
    jacobian = np.eye(6)
    jacobian[:3, 3:] = _minus_cross(displacement)
    return jacobian


def _minus_cross(vector: FloatArray) -> FloatArray:
    """Return the matrix `(3, 3)` that maps w to `w x vector`."""
    x, y, z = vector.tolist()
    return np.array(((0.0, z, -y), (-z, 0.0, x), (y, -x, 0.0)))


def propagated_covariance(
    covariance: FloatArray, displacement: FloatArray, rotation: FloatArray = NO_ROTATION
) -> FloatArray:
    """Return `F P F^T`, the covariance of a pose that is rigidly attached to a pose with the covariance P `(6, 6)`.

    `rotation` takes components in the frame of P to the frame of the result. `displacement` `(3,)`, metres, points from
    the pose with the covariance P to the attached pose, in the frame of the result.
    """
    if not covariance.any():
        return np.zeros((6, 6))  # many terms of a covariance are usually zero
    jacobian = np.zeros((6, 6))
    jacobian[:3, :3] = rotation
    jacobian[3:, 3:] = rotation
    jacobian[:3, 3:] = _minus_cross(displacement).dot(rotation)  # `dot` as in `Transform.__matmul__`
    return np.asarray(jacobian.dot(covariance).dot(jacobian.T))


def interpolated(before: Transform, after: Transform, fraction: float) -> Transform:
    """Return the transform at a fraction, 0 to 1, of a motion with constant velocities from `before` to `after`."""
    rotvec = rotvec_from_matrix(before.rotation.T @ after.rotation)
    rotation = before.rotation @ matrix_from_rotvec(fraction * rotvec)
    return Transform(rotation, before.translation + fraction * (after.translation - before.translation))


def symmetric(matrix: FloatArray) -> FloatArray:
    """Return the symmetric part of a matrix, such as a propagated covariance with rounding errors."""
    return np.asarray(0.5 * (matrix + matrix.T))
