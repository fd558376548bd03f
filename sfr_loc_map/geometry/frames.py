"""The frames of the rover by name, and the positions that the source document fixes [3.2].

All are in RB (x forward, y left, z up), metres.
"""

from __future__ import annotations

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.transform import Transform

GROUND_HEIGHT_RB_M = -0.540
"""Height of the ground plane in RB when deployed on flat ground [3.2.1]."""
MAST_XY_RB_M = (0.451, 0.317)
"""Base of the mast (DMA) and the pan axis in RB [3.2.2, 3.2.6]."""
TILT_AXIS_Z_RB_M = 0.594
"""Height of the tilt axis in RB [3.2.6]."""
TILT_AXIS_X_RB_M = 0.451
"""Place of the tilt axis along RB x at pan 0 [3.2.6]."""


def mast_head_in_rb(pan_rad: float, tilt_rad: float) -> Transform:
    """Return `T_rb_head`: the mast head, origin where the tilt axis meets the pan axis' x-z plane [3.2.6].

    Args:
        pan_rad: About z of RB, positive to the left; carries the tilt axis.
        tilt_rad: About the tilt axis (y of RB at pan 0); positive turns the view down, as a right-handed turn about
            +y does.
    """
    pan: FloatArray = matrix_from_rotvec([0.0, 0.0, pan_rad])
    tilt: FloatArray = matrix_from_rotvec([0.0, tilt_rad, 0.0])
    return Transform(pan @ tilt, np.array([TILT_AXIS_X_RB_M, MAST_XY_RB_M[1], TILT_AXIS_Z_RB_M]))
