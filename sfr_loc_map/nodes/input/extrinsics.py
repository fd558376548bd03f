"""The place of the localisation stereo bench on the rover, as parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sfr_loc_map.config import param
from sfr_loc_map.errors import ConfigError
from sfr_loc_map.geometry.transform import Transform


@dataclass(frozen=True, slots=True)
class MountConfig:
    """Place of the localisation stereo bench on the rover."""

    translation_m: tuple[float, ...] = param((0.0, 0.0, 0.0), unit="m", doc="Origin of LOCSB in RB: x, y, z.")
    quat_xyzw: tuple[float, ...] = param(
        (0.0, 0.0, 0.0, 0.0),
        doc="Orientation of LOCSB in RB: x, y, z, w; takes components in LOCSB to RB. All zero: not given, the place "
        "is then taken from /tf_static (rb_frame to locsb_frame) where tf2_msgs is installed.",
    )

    def transform(self) -> Transform | None:
        """Return `T_rb_locsb`, None where it is not given.

        Raises:
            ConfigError: If the values are not a place.
        """
        if len(self.translation_m) != 3 or len(self.quat_xyzw) != 4:
            raise ConfigError("T_rb_locsb needs translation_m [x, y, z] and quat_xyzw [x, y, z, w]")
        if not any(self.quat_xyzw):
            if any(self.translation_m):
                raise ConfigError("T_rb_locsb.translation_m is given but quat_xyzw is not: give both")
            return None
        if abs(float(np.linalg.norm(self.quat_xyzw)) - 1.0) > 1e-3:
            raise ConfigError(f"T_rb_locsb.quat_xyzw is {list(self.quat_xyzw)}: a unit quaternion is needed")
        return Transform.from_quat(self.translation_m, self.quat_xyzw)
