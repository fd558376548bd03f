"""Rigid transforms, and how the covariance of a pose propagates through them."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite

import numpy as np
from numpy.typing import ArrayLike

from sfr_loc_map.errors import GeometryError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.plausibility import MAX_POSITION_M, QUATERNION_SQUARES, plausible_rotations
from sfr_loc_map.geometry.rotation import (
    matrix_from_quat,
    matrix_from_rotvec,
    quat_conjugate,
    quat_from_matrix,
    rotvec_from_matrix,
)

IDENTITY = np.eye(3)
"""Rotation between frames of the same axes."""


@dataclass(frozen=True, slots=True, eq=False)
class Transform:
    """Rigid motion `T_a_b`: takes points given in frame b to frame a.

    `from_matrix` and `from_quat`, which take numbers from outside, check that the rotation is one. The constructor does
    not, because products and inverses of rotations are rotations.
    """

    rotation: FloatArray  #: `(3, 3)` float64, det +1, turns components in b into components in a.
    translation: FloatArray  #: `(3,)` float64, metres, the origin of b in a.
    #: `(4,)` float64, the quaternion that `from_quat` was given, None otherwise. It is kept here because files must be
    #: written with the digits that were read (`file_quat_xyzw`), and no calculation uses it.
    given_quat_xyzw: FloatArray | None = None

    def __post_init__(self) -> None:
        """Check shapes and values; GeometryError if a number is not finite or the translation absurdly long."""
        if self.rotation.shape != (3, 3) or self.translation.shape != (3,):
            shapes = f"{self.rotation.shape}, {self.translation.shape}"
            raise GeometryError(f"a transform needs (3, 3) and (3,): got {shapes}")
        position = self.translation.tolist()  # loops over a few numbers are faster than arrays of them
        numbers = (*position, *self.rotation.reshape(-1).tolist())
        if not all(map(isfinite, numbers)):
            raise GeometryError("a transform has a number that is not finite")
        if max(map(abs, position)) > MAX_POSITION_M:
            raise GeometryError(
                f"a position is {self.translation.tolist()} m: up to {MAX_POSITION_M:g} m are allowed, in metres"
            )

    @classmethod
    def identity(cls) -> Transform:
        """Return the transform between two frames that coincide."""
        return cls(np.eye(3), np.zeros(3))

    @classmethod
    def from_quat(cls, translation: ArrayLike, quat_xyzw: ArrayLike) -> Transform:
        """Return `T_a_b` from the origin of b in a, metres, and the orientation of b in a, as in ROS messages.

        The quaternion takes components in b to a; it is normalised here, and refused if its length is not 1 +- 1e-2.
        """
        quat = np.array(quat_xyzw, dtype=np.float64)
        low, high = QUATERNION_SQUARES
        if quat.shape != (4,) or not low <= sum(value * value for value in quat.tolist()) <= high:
            raise GeometryError(f"the quaternion {quat.tolist()} is not a rotation: a unit quaternion is required")
        return cls(matrix_from_quat(quat), np.array(translation, dtype=np.float64), quat)

    @classmethod
    def from_matrix(cls, matrix: FloatArray) -> Transform:
        """Return `T_a_b` of a matrix `(3, 4)` or `(4, 4)`; GeometryError if its rotation is invalid."""
        if not plausible_rotations(matrix[:3, :3]):
            raise GeometryError("a rotation matrix is not orthonormal with determinant +1")
        return cls(matrix[:3, :3].copy(), matrix[:3, 3].copy())

    @classmethod
    def from_origin_and_attitude(cls, origin: ArrayLike, att_q: ArrayLike) -> Transform:
        """Return `T_a_b` from `bOriginPos_m_A` and `att_q_AToB` [3.1.2], the conjugate of the ROS orientation."""
        return cls.from_quat(origin, quat_conjugate(att_q))

    @property
    def quat_xyzw(self) -> FloatArray:
        """Orientation of b in a `(4,)`, scalar last and >= 0, as in ROS messages."""
        return quat_from_matrix(self.rotation)

    @property
    def file_quat_xyzw(self) -> FloatArray:
        """Orientation of b in a `(4,)` for files and messages: as it was given, otherwise `quat_xyzw`."""
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
        """Return `T_a_c` of `T_a_b @ T_b_c`."""
        # `dot` gives what `@` gives, and is faster for so few numbers
        return Transform(self.rotation.dot(other.rotation), self.rotation.dot(other.translation) + self.translation)

    def apply(self, points: ArrayLike) -> FloatArray:
        """Take points `(..., 3)` given in b, metres, to a."""
        return np.asarray(np.asarray(points, dtype=np.float64) @ self.rotation.T + self.translation)


def propagation(displacement: FloatArray) -> FloatArray:
    """Return F `(6, 6)`, which maps the error of a pose to that of a pose rigidly attached to it, in ROS order.

    A rotation error w about the fixed axes of a frame moves a pose at the displacement d by `w x d`.
    """
    jacobian = np.eye(6)
    jacobian[:3, 3:] = _minus_cross(displacement)
    return jacobian


def _minus_cross(vector: FloatArray) -> FloatArray:
    """Return the matrix `(3, 3)` of `w -> w x vector`."""
    x, y, z = vector.tolist()
    return np.array(((0.0, z, -y), (-z, 0.0, x), (y, -x, 0.0)))


def propagated_covariance(
    covariance: FloatArray, displacement: FloatArray, rotation: FloatArray = IDENTITY
) -> FloatArray:
    """Return `F P F^T`, the covariance of a pose rigidly attached to one with the covariance P `(6, 6)`.

    The errors of the given pose are about axes that the rotation takes to those of the result.
    """
    jacobian = np.zeros((6, 6))
    jacobian[:3, :3] = rotation
    jacobian[3:, 3:] = rotation
    jacobian[:3, 3:] = _minus_cross(displacement).dot(rotation)  # `dot` as in `Transform.__matmul__`
    return np.asarray(jacobian.dot(covariance).dot(jacobian.T))


def interpolated(before: Transform, after: Transform, fraction: float) -> Transform:
    """Return the transform at a fraction, 0 to 1, of a motion with constant velocities from one to the other."""
    rotvec = rotvec_from_matrix(before.rotation.T @ after.rotation)
    rotation = before.rotation @ matrix_from_rotvec(fraction * rotvec)
    return Transform(rotation, before.translation + fraction * (after.translation - before.translation))
