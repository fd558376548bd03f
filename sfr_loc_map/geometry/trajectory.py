"""Stamped poses of the rover."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self, overload

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import GeometryError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray, kind_of
from sfr_loc_map.geometry.plausibility import MAX_POSITION_M, plausible_poses
from sfr_loc_map.geometry.rotation import quat_conjugate, quat_normalised, quat_rotate
from sfr_loc_map.geometry.transform import Transform


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Stamped poses of RB in DS, stored exactly as given (not sorted, quaternions not normalised).

    If the attitudes are unknown, every quaternion is zero, as in a message with an unset orientation. Iterating and
    `poses[3]` return `(stamp_ns, pose)`; `poses[10:20]` and masks return a trajectory.
    """

    stamps_ns: IntArray  #: `(N,)` int64, nanoseconds.
    positions: FloatArray  #: `(N, 3)` float64, metres, the RB origin in DS (`rbOriginPos_m_Ds`).
    #: `(N, 4)` float64, orientation of RB in DS as in ROS messages. The quaternion takes components in RB to DS, and is
    #: the conjugate of `att_q_DsToRb`.
    quats_xyzw: FloatArray

    def __post_init__(self) -> None:
        """Check shapes and values; GeometryError if stamps are not whole numbers or a pose is invalid."""
        count = np.size(self.stamps_ns)
        arrays = (self.stamps_ns, self.positions, self.quats_xyzw)
        shapes = tuple(getattr(array, "shape", None) for array in arrays)
        if shapes != ((count,), (count, 3), (count, 4)):
            raise GeometryError(
                f"stamps, positions and quaternions are {', '.join(map(kind_of, arrays))}: arrays (N,), (N, 3) and "
                "(N, 4) are required"
            )
        if not np.issubdtype(self.stamps_ns.dtype, np.signedinteger):
            raise GeometryError(f"stamps are {self.stamps_ns.dtype}: whole nanoseconds, int64, are required")
        is_invalid = ~plausible_poses(self.positions, self.quats_xyzw)
        if is_invalid.any():
            first = int(np.argmax(is_invalid))
            count_invalid = int(is_invalid.sum())
            raise GeometryError(
                f"pose {first} (stamp {int(self.stamps_ns[first])}) is invalid: {self.positions[first].tolist()} m, "
                f"{self.quats_xyzw[first].tolist()} ({count_invalid} of {count} poses are invalid): finite positions "
                f"below {MAX_POSITION_M:g} m and unit quaternions are required; correct or remove these poses"
            )

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @property
    def has_attitude(self) -> bool:
        """Whether the poses have attitudes; otherwise they have only positions."""
        return bool(self.quats_xyzw.any()) or not len(self.stamps_ns)

    @property
    def att_q_ds_to_rb(self) -> FloatArray:
        """The source document's `att_q_DsToRb` `(N, 4)`: the conjugate of `quats_xyzw`."""
        return quat_conjugate(self.quats_xyzw)

    def pose(self, index: int) -> Transform:
        """Return `T_ds_rb` of one pose; GeometryError if the attitude is unknown."""
        if not self.quats_xyzw[index].any():
            raise GeometryError(f"the pose at stamp {int(self.stamps_ns[index])} has no attitude: give its attitude")
        return Transform.from_quat(self.positions[index], self.quats_xyzw[index])

    @classmethod
    def empty(cls) -> Self:
        """Return a trajectory without poses."""
        return cls(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 4)))

    @classmethod
    def from_poses(cls, stamped: Iterable[tuple[int, Transform]]) -> Self:
        """Return the trajectory of pairs `(stamp_ns, T_ds_rb)`; GeometryError if an item is not such a pair."""
        items = [*stamped] if isinstance(stamped, Iterable) else [stamped]
        for item in items:
            if not (isinstance(item, tuple | list) and len(item) == 2 and isinstance(item[1], Transform)):
                raise GeometryError(f"a pose has the type {type(item).__name__}: (stamp_ns, T_ds_rb) is required")
        return cls(
            np.array([stamp for stamp, _ in items], dtype=np.int64),
            np.array([pose.translation for _, pose in items]).reshape(-1, 3),
            np.array([pose.quat_xyzw for _, pose in items]).reshape(-1, 4),
        )

    def __iter__(self) -> Iterator[tuple[int, Transform]]:
        """Yield each stamp, ns, and pose `T_ds_rb`."""
        for index, stamp_ns in enumerate(self.stamps_ns.tolist()):
            yield stamp_ns, self.pose(index)

    @overload
    def __getitem__(self, key: int) -> tuple[int, Transform]: ...

    @overload
    def __getitem__(self, key: slice | Sequence[int] | NDArray[np.generic]) -> Self: ...

    def __getitem__(self, key: Any) -> tuple[int, Transform] | Self:
        """Return stamp, ns, and pose at an index; a trajectory for a slice, indices or a mask.

        GeometryError for a single boolean.
        """
        if isinstance(key, bool | np.bool_):
            raise GeometryError(f"the index is {key}: a whole number, a slice, indices or a mask is required")
        if isinstance(key, int | np.integer):
            return int(self.stamps_ns[key]), self.pose(int(key))
        return self.at_rows(np.arange(len(self))[key])

    def at_rows(self, rows: NDArray[np.intp]) -> Self:
        """Return the poses in `rows`."""
        return replace(
            self, stamps_ns=self.stamps_ns[rows], positions=self.positions[rows], quats_xyzw=self.quats_xyzw[rows]
        )


def at_point(poses: Trajectory, point_m: Sequence[float]) -> Trajectory:
    """Return the trajectory of a point that is fixed in RB, `point_m` `(3,)`, metres, with the attitude of RB."""
    moved = poses.positions + quat_rotate(quat_normalised(poses.quats_xyzw), np.asarray(point_m))
    return Trajectory(poses.stamps_ns, moved, poses.quats_xyzw)


@dataclass(frozen=True, slots=True, eq=False)
class Truth(Trajectory):
    """True poses of RB in DS; if the attitudes are unknown, the true positions of a point of RB."""

    sigma_m: float = 0.0  #: Standard deviation of a position along each axis, metres; 0 if exact or unknown.
    sigma_deg: float = 0.0  #: Standard deviation of an attitude about each axis, deg; 0 if exact or unknown.
    lever_arm_m: tuple[float, ...] = (0.0, 0.0, 0.0)  #: The point in RB whose positions are given, metres.
    has_height: bool = True  #: Whether z is known; otherwise z is a placeholder and only horizontal errors are known.
    has_tilt: bool = True  #: Whether roll and pitch are known; otherwise only the heading is known.
    read_from: str = ""  #: File or topic that the trajectory was read from.
    declared: tuple[str, ...] = ()  #: Settings `truth.NAME=VALUE` that changed the poses when the file was read.
    findings: tuple[str, ...] = ()  #: Findings about impossible poses and jumps.


def as_truth(trajectory: Trajectory) -> Truth:
    """Return a trajectory as a truth. A trajectory that is not a `Truth` is assumed to be complete and exact.

    Unknown heights are 0 in the result. The path of the truth is then horizontal.
    """
    if not isinstance(trajectory, Truth):
        return Truth(trajectory.stamps_ns, trajectory.positions, trajectory.quats_xyzw)
    if trajectory.has_height:
        return trajectory
    return replace(trajectory, positions=horizontal(trajectory.positions))


def horizontal(positions: FloatArray) -> FloatArray:
    """Return positions `(N, 3)` with the height 0."""
    level = positions.copy()
    level[:, 2] = 0.0
    return level
