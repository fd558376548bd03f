"""The convention of the poses of an estimate, and the conversion to poses of RB in DS.

Each setting declares one difference. The differences are corrected in this order: stamps, quaternions, unit, mirroring,
inversion, frame of the rover (`converted`), world frame (`aligned`). Values that need no correction stay bit-identical.
`converted_estimates` converts poses with their covariances.

`metrics.conventions.convention_diagnosis` finds a difference that is not declared.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np

from sfr_loc_map.configuration.parameters import build, changed, check_parameters, param, parameters
from sfr_loc_map.errors import ConfigError, GeometryError, MetricsError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.rotation import quat_conjugate, quat_from_matrix, quat_multiply, quat_normalised, quat_rotate
from sfr_loc_map.geometry.stereo import OPTICAL_IN_BODY, StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform, propagation
from sfr_loc_map.metrics.config import AssociationConfig
from sfr_loc_map.metrics.frames.association import Estimates, associate, check_attitudes, unique_rows
from sfr_loc_map.metrics.frames.covariance import COVARIANCE_SIZE, UPPER, propagated, symmetric
from sfr_loc_map.metrics.frames.true_attitudes import check_true_attitudes

RB = "rb"  #: Frame of the rover [3.2.1].
RB_OPTICAL = "rb_optical"  #: Frame with the origin of RB and optical axes.
RB_FRD = "rb_frd"  #: Frame with the origin of RB and the axes x forward, y right, z down (NED).
FRAMES = (RB, RB_OPTICAL, RB_FRD, "sb", "left", "right", "left_optical", "right_optical")
"""Frames of the rover: RB, RB with optical axes or axes of NED, the stereo rig SB, and the cameras with axes of SB or
optical axes."""
FRD_IN_BODY = np.diag([1.0, -1.0, -1.0])  #: Converts components in `RB_FRD` to RB.
MIRROR = np.array([1.0, -1.0, 1.0])  #: Factors that mirror a position in the x-z plane.
MIRROR_QUAT = np.array([-1.0, 1.0, -1.0, 1.0])  #: Factors that mirror a quaternion in the x-z plane.
FIRST_POSE = "first_pose"  #: World frame that is aligned with the truth at the first pose.
MAX_OFFSET_NS = 2**62  #: Maximum offset of stamps, ns, whose sum with a stamp fits 64 bits.


UNITS_M = (0.0254, 0.3048, 1200.0 / 3937.0, 0.9144)
"""Units of positions that are not a power of ten of a metre: inch, foot, US survey foot and yard, m."""


@dataclass(frozen=True, slots=True)
class PoseConvention:
    """Differences of an estimate from poses of RB in DS with orientations as in ROS and positions in metres."""

    frame: str = param("rb", doc="Frame on the rover that the given poses describe.", choices=FRAMES)
    extrinsics: tuple[float, ...] = param(
        (),
        unit="m",
        doc="Pose in RB of another frame that the given poses describe: x,y,z,qx,qy,qz,qw.",
        low=-100.0,
        high=100.0,
    )
    world: str = param(
        "ds",
        doc="World frame: DS, or a frame that is aligned at the first pose with the truth (without truth: identity).",
        choices=("ds", FIRST_POSE),
    )
    quaternion: str = param(
        "xyzw",
        doc="Quaternions: as in ROS, scalar first, conjugated (rotation from DS to RB), conjugated and scalar first, "
        "or scalar first in the columns att_q_DsToRb of a csv file.",
        choices=("xyzw", "wxyz", "conjugated", "conjugated_wxyz", "wxyz_ds_to_rb"),
    )
    inverse: bool = param(False, doc="Poses are inverted: they describe the world in the frame of the rover.")
    inverse_motion: bool = param(False, doc="Motions since the first pose are inverted; the first pose is not.")
    mirrored: bool = param(False, doc="Left and right are mirrored: the y-axis points to the right.")
    metres_per_unit: float = param(1.0, unit="m", doc="Unit of the positions in metres.", low=1e-6, high=1e6)
    time_offset_ns: int = param(
        0, unit="ns", doc="Offset that is added to the stamps.", low=-MAX_OFFSET_NS, high=MAX_OFFSET_NS
    )

    def __post_init__(self) -> None:
        """Check the settings; ConfigError if a value is invalid, or if settings exclude each other."""
        check_parameters(self)
        if self.extrinsics and len(self.extrinsics) != 7:
            raise ConfigError(
                f"extrinsics has {len(self.extrinsics)} numbers: seven numbers, x,y,z,qx,qy,qz,qw, are required"
            )
        if self.extrinsics and self.frame != RB:
            raise ConfigError(f"extrinsics and frame={self.frame} exclude each other: give one of them")
        if self.extrinsics:
            try:
                quat_normalised(self.extrinsics[3:])
            except GeometryError as error:
                raise ConfigError(f"extrinsics: {error}") from error
        if self.inverse and self.inverse_motion:
            raise ConfigError("inverse and inverse_motion exclude each other: give one of them")

    @classmethod
    def parse(cls, texts: Sequence[str]) -> PoseConvention:
        """Return the convention of settings `NAME=VALUE`; ConfigError if one is invalid or given twice."""
        types = {info.name: info.type for info in parameters(cls)}
        values: dict[str, object] = {}
        for text in texts:
            name, separator, value = text.partition("=")
            if not separator or name in values:
                problem = "is given twice" if separator else "NAME=VALUE is required, such as frame=left_optical"
                raise ConfigError(f"convention '{text}': {problem}")
            try:
                content = value.split(",") if name == "extrinsics" else value
                values[name] = msgspec.convert(content, types.get(name, str), strict=False)
            except msgspec.ValidationError as error:
                raise ConfigError(f"convention '{text}': {error}") from error
        return build(cls, values, origin="convention")

    @property
    def settings(self) -> tuple[str, ...]:
        """The settings that differ from the default, in the form that `parse` reads."""
        differing = changed(self)
        if self.extrinsics:
            differing = {**differing, "extrinsics": ",".join(map(repr, self.extrinsics))}
        return tuple(f"{name}={str(value).lower()}" for name, value in differing.items())

    @property
    def has_fitted_unit(self) -> bool:
        """Whether the factor of the positions was probably fitted, because it is not a known unit of length."""
        exponent = np.log10(self.metres_per_unit)
        is_power_of_ten = bool(np.isclose(exponent, np.rint(exponent), rtol=0.0, atol=1e-9))
        return not is_power_of_ten and not bool(np.isclose(self.metres_per_unit, UNITS_M, rtol=1e-6, atol=0.0).any())

    @property
    def of_another_frame(self) -> bool:
        """Whether the poses are those of a frame other than RB."""
        return bool(self.extrinsics) or self.frame != RB

    def T_rb_child(self, rig: StereoRig | None) -> Transform:
        """Return the pose in RB of the frame whose poses are given; ConfigError if the required rig is unknown."""
        if self.extrinsics:
            return Transform.from_quat(self.extrinsics[:3], self.extrinsics[3:])
        rotations = {RB: np.eye(3), RB_OPTICAL: OPTICAL_IN_BODY, RB_FRD: FRD_IN_BODY}
        if self.frame in rotations:
            return Transform(rotations[self.frame], np.zeros(3))
        if rig is None or rig.T_rb_sb is None:
            raise ConfigError(
                f"convention 'frame={self.frame}' requires the pose of the cameras in RB (T_rb_locsb), which the "
                "source does not have: give a source with this pose, or extrinsics=x,y,z,qx,qy,qz,qw"
            )
        side = {"left": 0.5, "right": -0.5}.get(self.frame.removesuffix("_optical"), 0.0)
        rotation = OPTICAL_IN_BODY if self.frame.endswith("_optical") else np.eye(3)
        return rig.T_rb_sb @ Transform(rotation, np.array([0.0, side * rig.baseline_m, 0.0]))


def converted(trajectory: Trajectory, convention: PoseConvention, T_rb_child: Transform) -> Trajectory:
    """Return poses of RB in the world frame of the estimate, from poses of a child frame of RB in a convention.

    The poses may be in any order. Inverted motions begin at the pose with the earliest stamp.
    """
    stamps = trajectory.stamps_ns
    if convention.time_offset_ns:
        stamps = stamps + np.int64(convention.time_offset_ns)
    first = int(unique_rows(stamps)[0]) if len(stamps) else 0
    positions, quats = poses_of_rb(trajectory.positions, trajectory.quats_xyzw, convention, T_rb_child, first)
    return Trajectory(stamps, positions, quats)


def poses_of_rb(
    positions: FloatArray, quats: FloatArray, convention: PoseConvention, T_rb_child: Transform, first_row: int = 0
) -> tuple[FloatArray, FloatArray]:
    """Return positions `(N, 3)` and quaternions `(N, 4)` of RB, from those of a child frame of RB in a convention.

    `first_row` is the row of the earliest pose, at which inverted motions begin.
    """
    order = convention.quaternion
    if order == "wxyz_ds_to_rb":  # the reader has conjugated the columns att_q_DsToRb as if they were scalar last
        quats = quat_conjugate(quats)
    if "wxyz" in order:
        quats = quats[:, [1, 2, 3, 0]]
    if order not in ("xyzw", "wxyz"):
        quats = quat_conjugate(quats)
    if convention.metres_per_unit != 1.0:
        positions = positions * convention.metres_per_unit
    if convention.mirrored:
        positions = positions * MIRROR
        quats = quats * MIRROR_QUAT
    if convention.inverse or convention.inverse_motion:
        has_first = convention.inverse_motion and len(positions) > 0
        first = Transform.from_quat(positions[first_row], quats[first_row]) if has_first else Transform.identity()
        quats = quat_normalised(quat_conjugate(quats))
        positions = first.apply(quat_rotate(quats, first.translation - positions))
        quats = quat_multiply(quat_multiply(first.quat_xyzw, quats), first.quat_xyzw)
    if convention.of_another_frame:
        return poses_of_parent(positions, quats, T_rb_child)
    return positions, quats


def poses_of_parent(positions: FloatArray, quats: FloatArray, T_rb_child: Transform) -> tuple[FloatArray, FloatArray]:
    """Return positions `(N, 3)` and quaternions `(N, 4)` of RB from those of a frame that is fixed in RB."""
    quats = quat_multiply(quat_normalised(quats), quat_from_matrix(T_rb_child.rotation.T))
    return positions - quat_rotate(quats, T_rb_child.translation), quats


def aligned(trajectory: Trajectory, T_ds_world: Transform) -> Trajectory:
    """Return poses in DS from poses in another world frame."""
    quats = quat_multiply(T_ds_world.quat_xyzw, trajectory.quats_xyzw)
    return Trajectory(trajectory.stamps_ns, T_ds_world.apply(trajectory.positions), quats)


def converted_estimates(
    estimates: Estimates, convention: PoseConvention, T_rb_child: Transform, truth: Trajectory | None
) -> Estimates:
    """Convert estimates from poses of a child frame of RB, in a convention, to poses of RB in DS.

    With `world=first_pose` the first pose that is not lost is aligned with its true pose, or with the identity if there
    is no truth. Covariances are propagated, but removed if poses are inverted or mirrored. Steps (`step_cov`) are
    motions of RB and are kept only if the conventions are equal except for the world frame and the stamps. MetricsError
    if the estimate has only positions, or if the world frame cannot be aligned (`world_at_first_pose`).
    """
    check_attitudes(estimates.trajectory)
    poses = converted(estimates.trajectory, convention, T_rb_child)
    is_turned = convention.inverse or convention.inverse_motion or convention.mirrored
    covariance = None if is_turned else estimates.covariance
    if covariance is not None and (convention.metres_per_unit != 1.0 or convention.of_another_frame):
        unit = np.diag([convention.metres_per_unit] * 3 + [1.0] * 3)
        arms = -quat_rotate(quat_normalised(poses.quats_xyzw), T_rb_child.translation)
        jacobians = np.array([propagation(arm) @ unit for arm in arms]).reshape(-1, 6, 6)
        covariance = _propagated_triangles(covariance, jacobians)
    plain = convention == PoseConvention(world=convention.world, time_offset_ns=convention.time_offset_ns)
    result = replace(estimates, trajectory=poses, covariance=covariance, steps=estimates.steps if plain else None)
    if convention.world != FIRST_POSE:
        return result
    return aligned_estimates(result, world_at_first_pose(result, truth))


def aligned_estimates(estimates: Estimates, T_ds_world: Transform) -> Estimates:
    """Return estimates in DS, with their covariances, from estimates in another world frame."""
    covariance = estimates.covariance
    if covariance is not None:
        covariance = _propagated_triangles(covariance, np.asarray(np.kron(np.eye(2), T_ds_world.rotation), np.float64))
    return replace(estimates, trajectory=aligned(estimates.trajectory, T_ds_world), covariance=covariance)


def world_at_first_pose(estimates: Estimates, truth: Trajectory | None) -> Transform:
    """Return `T_ds_world`, which aligns the first pose that is not lost with its true pose, or without truth with DS.

    The poses may be in any order; the first pose is that with the earliest stamp. MetricsError if every pose is lost,
    if the truth has only positions or no roll and pitch, or if no pose has a true pose at its stamp.
    """
    if truth is None:
        rows = unique_rows(estimates.trajectory.stamps_ns)
        tracked = rows[~estimates.lost[rows]]
        if not len(tracked):
            raise MetricsError(
                "the estimate has no pose that is not lost, so the world frame cannot be aligned: give such a pose, or "
                "set world=ds"
            )
        return estimates.trajectory.pose(int(tracked[0])).inverse()
    check_true_attitudes(truth, "world=first_pose", "set world=ds")
    frames = associate(estimates.trajectory, truth, AssociationConfig())[0]
    known = np.flatnonzero(~estimates.lost[frames.estimate_rows])
    if not len(known):
        raise MetricsError(
            "no estimated pose has a true pose at its stamp, so the world frame cannot be aligned: check the "
            "stamps, or set world=ds"
        )
    first = int(known[0])
    true = Transform.from_quat(frames.true_position[first], frames.true_attitude[first])
    return true @ Transform.from_quat(frames.position[first], frames.attitude[first]).inverse()


def _propagated_triangles(covariance: FloatArray, jacobian: FloatArray) -> FloatArray:
    """Return the upper triangles `(N, 21)` of covariances that are propagated by Jacobians `(N, 6, 6)` or `(6, 6)`."""
    moved = propagated(jacobian, symmetric(covariance))
    return np.ascontiguousarray(moved[:, UPPER[0], UPPER[1]]).reshape(-1, COVARIANCE_SIZE)
