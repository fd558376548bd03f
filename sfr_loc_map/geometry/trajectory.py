"""Stamped poses of the rover."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from sfr_loc_map.errors import GeometryError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.geometry.plausibility import MAX_POSITION_M, plausible_positions, plausible_quats
from sfr_loc_map.geometry.rotation import quat_conjugate, quat_normalised, quat_rotate
from sfr_loc_map.geometry.transform import Transform


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Poses of RB in DS at stamps, kept exactly as given (not sorted, quaternions not normalised).

    Where no attitude is known every quaternion is zero, as in a message that does not set it.
    """

    stamps_ns: IntArray  #: `(N,)` int64, nanoseconds.
    positions: FloatArray  #: `(N, 3)` float64, metres, the RB origin in DS (`rbOriginPos_m_Ds`).
    #: `(N, 4)` float64, orientation of RB in DS as in ROS messages: takes components in RB to DS, the conjugate of
    #: `att_q_DsToRb`.
    quats_xyzw: FloatArray

    def __post_init__(self) -> None:
        """Check shapes and values; GeometryError if stamps are no whole numbers or a pose is none."""
        count = len(self.stamps_ns)
        shapes = self.stamps_ns.shape, self.positions.shape, self.quats_xyzw.shape
        if shapes != ((count,), (count, 3), (count, 4)):
            raise GeometryError(f"a trajectory needs shapes (N,), (N, 3), (N, 4): got {shapes}")
        if not np.issubdtype(self.stamps_ns.dtype, np.signedinteger):
            raise GeometryError(f"stamps are {self.stamps_ns.dtype}: whole nanoseconds, int64, are needed")
        turned = plausible_quats(self.quats_xyzw) | (not self.quats_xyzw.any())
        bad = ~(plausible_positions(self.positions) & turned)
        if bad.any():
            first = int(np.argmax(bad))
            raise GeometryError(
                f"pose {first} (stamp {int(self.stamps_ns[first])}) is none: {self.positions[first].tolist()} m, "
                f"{self.quats_xyzw[first].tolist()} ({int(bad.sum())} of {count} such poses): finite positions below "
                f"{MAX_POSITION_M:g} m and unit quaternions are needed; correct or leave out these poses"
            )

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @property
    def has_attitude(self) -> bool:
        """Whether the poses have attitudes, not positions alone."""
        return bool(self.quats_xyzw.any()) or not len(self.stamps_ns)

    @property
    def att_q_ds_to_rb(self) -> FloatArray:
        """Attitude as the source document names it, `att_q_DsToRb` `(N, 4)`: the conjugate of `quats_xyzw`."""
        return quat_conjugate(self.quats_xyzw)

    def pose(self, index: int) -> Transform:
        """Return `T_ds_rb` of one pose; GeometryError if there is no attitude."""
        if not self.quats_xyzw[index].any():
            raise GeometryError("the truth has positions alone, no poses: start at the identity")
        return Transform.from_quat(self.positions[index], self.quats_xyzw[index])

    @classmethod
    def empty(cls) -> Self:
        """Return a trajectory without poses."""
        return cls(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 4)))

    @classmethod
    def from_poses(cls, stamped: Iterable[tuple[int, Transform]]) -> Self:
        """Return the trajectory of `(stamp_ns, T_ds_rb)`."""
        items = list(stamped)
        return cls(
            np.array([stamp for stamp, _ in items], dtype=np.int64),
            np.array([pose.translation for _, pose in items]).reshape(-1, 3),
            np.array([pose.quat_xyzw for _, pose in items]).reshape(-1, 4),
        )


def at_point(poses: Trajectory, point_m: Sequence[float]) -> Trajectory:
    """Return positions of a point given in RB, with the attitude of RB."""
    moved = poses.positions + quat_rotate(quat_normalised(poses.quats_xyzw), np.asarray(point_m))
    return Trajectory(poses.stamps_ns, moved, poses.quats_xyzw)


@dataclass(frozen=True, slots=True, eq=False)
class Truth(Trajectory):
    """True poses of RB in DS; without attitudes the positions of a point of RB."""

    sigma_m: float = 0.0  #: Standard deviation of a position along each axis; 0: exact, or not known.
    sigma_deg: float = 0.0  #: Standard deviation of an attitude about each axis, likewise.
    lever_arm_m: tuple[float, ...] = (0.0, 0.0, 0.0)  #: The point in RB whose positions these are.
    read_from: str = ""  #: What it was read from.
