"""The extrinsics of the localisation cameras: parameters, or /tf_static."""

from __future__ import annotations

from dataclasses import dataclass

from sfr_loc_map.config import param
from sfr_loc_map.errors import ConfigError, GeometryError
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.nodes.input.static_transforms import StaticTransforms
from sfr_loc_map.nodes.lifecycle.endpoints import Endpoints
from sfr_loc_map.nodes.messages.pose import tf_message_type


@dataclass(frozen=True, slots=True)
class ExtrinsicsConfig:
    """Pose of the localisation stereo rig on the rover."""

    translation_m: tuple[float, ...] = param(
        (0.0, 0.0, 0.0), unit="m", doc="Origin of LOCSB in RB: x, y, z.", low=-100.0, high=100.0
    )
    quat_xyzw: tuple[float, ...] = param(
        (0.0, 0.0, 0.0, 0.0),
        doc="Orientation of LOCSB in RB: x, y, z, w; takes components in LOCSB to RB. All zero: not given, the "
        "extrinsics are then taken from /tf_static (rb_frame to locsb_frame) where tf2_msgs is installed.",
        low=-10.0,
        high=10.0,
    )

    def transform(self) -> Transform | None:
        """Return `T_rb_locsb`, None where it is not given.

        Raises:
            ConfigError: If the values are not a rigid motion.
        """
        if len(self.translation_m) != 3 or len(self.quat_xyzw) != 4:
            raise ConfigError("T_rb_locsb needs translation_m [x, y, z] and quat_xyzw [x, y, z, w]")
        if not any(self.quat_xyzw):
            if any(self.translation_m):
                raise ConfigError("T_rb_locsb.translation_m is given but quat_xyzw is not: give both")
            return None
        try:
            return Transform.from_quat(self.translation_m, self.quat_xyzw)
        except GeometryError as error:
            raise ConfigError(f"T_rb_locsb: {error}") from error


class Extrinsics:
    """The extrinsics, from the parameters or else from /tf_static once it joins the frames.

    Attributes:
        T_rb_sb: Takes points in the stereo rig to RB; None where not known yet.
    """

    def __init__(self, config: ExtrinsicsConfig, rb_frame: str, sb_frame: str) -> None:
        """Take the parameters.

        Args:
            config: The parameters.
            rb_frame: Name of RB in /tf_static.
            sb_frame: Name of the stereo rig there.

        Raises:
            ConfigError: If they are not a rigid motion.
        """
        self.T_rb_sb = config.transform()
        self._rb_frame, self._sb_frame = rb_frame, sb_frame
        self._frames = StaticTransforms()

    def subscribe(self, endpoints: Endpoints) -> str | None:
        """Subscribe to /tf_static if they are not known; return what is missing then, in words."""
        if self.T_rb_sb is not None:
            return None
        self._frames.subscribe(endpoints, self._look_up)
        source = "/tf_static is awaited" if tf_message_type() else "tf2_msgs for /tf_static is not installed"
        return f"the extrinsics of the stereo rig (parameters T_rb_locsb) are not given: {source}"

    def _look_up(self) -> None:
        if self.T_rb_sb is None:
            self.T_rb_sb = self._frames.find(self._rb_frame, self._sb_frame)
