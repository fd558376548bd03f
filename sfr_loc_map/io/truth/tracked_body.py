"""The body that a truth tracks, and the conversion of its poses to true poses of RB.

A tracker measures its own body, such as a prism or an antenna, with its own clock. Only `TrackedBody.applied` converts
poses of this body to poses of RB. Positions without attitude remain those of the body; the score then evaluates the
estimate at the body.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from sfr_loc_map.config import changed, param
from sfr_loc_map.errors import ConfigError, InputError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.rotation import quat_conjugate, quat_multiply, quat_rotate
from sfr_loc_map.geometry.trajectory import Trajectory, Truth
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import LOST_VARIANCE, NS_PER_S
from sfr_loc_map.io.truth.pose_checks import possible_truth

NO_LEVER = (0.0, 0.0, 0.0)
NO_TURN = (0.0, 0.0, 0.0, 1.0)
PLACE_SETTINGS = ("truth.source", "truth.frame")  #: Settings of the origin of the truth.


@dataclass(frozen=True, slots=True)
class TrackedBody:
    """The body that a truth tracks, and the accuracy of the truth."""

    lever_arm_m: tuple[float, ...] = param(
        NO_LEVER, unit="m", doc="Position of the tracked body (prism, antenna, marker) in RB.", low=-100.0, high=100.0
    )
    lever_quat_xyzw: tuple[float, ...] = param(
        NO_TURN, doc="Orientation of the tracked body in RB, as in ROS messages.", low=-1.01, high=1.01
    )
    clock_offset_s: float = param(
        0.0, unit="s", doc="Offset that is added to the stamps of the truth.", low=-4e9, high=4e9
    )
    sigma_m: float = param(
        0.0,
        unit="m",
        doc="Standard deviation of a true position along each axis. 0: from the messages, otherwise exact.",
        low=0.0,
        high=1000.0,
    )
    sigma_deg: float = param(
        0.0, unit="deg", doc="Standard deviation of a true attitude about each axis, like sigma_m.", low=0.0, high=180.0
    )
    attitude: str = param(
        "auto", doc="Whether the truth has attitudes: inferred (auto), yes or no.", choices=("auto", "yes", "no")
    )
    unknown: str = param(
        "auto",
        doc="Unknown components of the truth: none, the height, roll and pitch (tilt), or both (planar). auto: "
        "components that its variances mark as unknown, or that never change along its path.",
        choices=("auto", "none", "height", "tilt", "planar"),
    )

    def __post_init__(self) -> None:
        if len(self.lever_arm_m) != 3 or len(self.lever_quat_xyzw) != 4:
            raise ConfigError("truth.lever_arm_m needs [x, y, z] and truth.lever_quat_xyzw needs [x, y, z, w]")
        if abs(float(np.linalg.norm(self.lever_quat_xyzw)) - 1.0) > 1e-2:
            raise ConfigError(f"truth.lever_quat_xyzw is {self.lever_quat_xyzw}: a unit quaternion is required")

    @property
    def has_lever(self) -> bool:
        """Whether the pose of the tracked body in RB differs from the identity."""
        return (self.lever_arm_m, self.lever_quat_xyzw) != (NO_LEVER, NO_TURN)

    def applied(self, poses: Trajectory, variances: FloatArray | None = None, read_from: str = "") -> Truth:
        """Return poses of the tracked body as the truth of RB; `variances`: `(N, 6)`, NaN or 0: unknown.

        The poses must be as recorded; a `Truth` is already converted.
        """
        assert not isinstance(poses, Truth)
        if variances is None:
            variances = np.full((len(poses), 6), np.nan)
        checked = possible_truth(poses, read_from, self.attitude, self.unknown, variances)
        poses, variances = checked.poses, variances[checked.kept]
        of_attitude = variances[:, 3:]
        is_known = (of_attitude < LOST_VARIANCE).any(axis=1) & (of_attitude >= 0.0).all(axis=1)
        is_stated = poses.has_attitude and bool(is_known.any() or np.isnan(of_attitude).any())
        has_attitude = {"yes": True, "no": False}.get(self.attitude, is_stated)
        if has_attitude and not poses.has_attitude:
            raise InputError(f"truth {read_from} has no attitudes: set truth.attitude to auto or no")
        positions, quats = poses.positions, poses.quats_xyzw if has_attitude else np.zeros((len(poses), 4))
        lever = np.array(self.lever_arm_m)
        if has_attitude and self.has_lever:
            quats = quat_multiply(quats, quat_conjugate(np.array(self.lever_quat_xyzw)))
            positions, lever = positions - quat_rotate(quats, lever), np.zeros(3)
        sigmas = [sigma_of(variances[:, :3]), np.degrees(sigma_of(of_attitude)) if has_attitude else 0.0]
        return Truth(
            poses.stamps_ns + round(self.clock_offset_s * NS_PER_S),
            positions,
            quats,
            sigma_m=self.sigma_m or sigmas[0],
            sigma_deg=self.sigma_deg or float(sigmas[1]),
            lever_arm_m=tuple(lever.tolist()),
            has_height=checked.has_height,
            has_tilt=checked.has_tilt or not has_attitude,
            read_from=read_from,
            declared=self.declared,
        )

    @property
    def declared(self) -> tuple[str, ...]:
        """The settings `truth.NAME=VALUE` that change poses, without `PLACE_SETTINGS`."""
        values = changed(self, "truth.").items()
        return tuple(f"{name}={value}" for name, value in values if name not in PLACE_SETTINGS)


RB_ITSELF = TrackedBody()  #: The tracked body is RB; the accuracy is that in the messages.


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class TrackedPoses(Trajectory):
    """Recorded poses of a tracked body, with the pose of the body in RB that the source gives."""

    T_rb_body: Transform = field(default_factory=Transform.identity)
    read_from: str = ""  #: File that the poses were read from.


def sigma_of(variances: FloatArray) -> float:
    """Return the median standard deviation per axis of messages with variances `(N, 3)`; 0: unknown."""
    known = variances[(variances > 0.0).all(axis=1) & (variances < LOST_VARIANCE).all(axis=1)]
    return float(np.sqrt(np.median(known.mean(axis=1)))) if len(known) else 0.0
