"""The disparities of the map: without the roll of the right camera, and within the range."""

from __future__ import annotations

import numpy as np

from sfr_loc_map.geometry.arrays import F
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.mapping.disparity.disparity_states import FilledDisparity, FinalDisparity
from sfr_loc_map.mapping.disparity.pixel_status import PixelStatus, is_valid, with_reason
from sfr_loc_map.mapping.disparity.right_camera import CameraRotation, roll_error_px


def final_disparity(
    filled: FilledDisparity, rotation: CameraRotation, rig: StereoRig, min_disparity_px: float
) -> FinalDisparity:
    """Return the disparities without the error of the roll of the right camera, NaN where invalid.

    Pixels beyond the maximum depth, where the corrected disparity is below `min_disparity_px`, become invalid.
    """
    px = filled.px - roll_error_px(rotation, rig)
    status = with_reason(filled.status, px < min_disparity_px, PixelStatus.BEYOND_RANGE)
    return FinalDisparity(np.where(is_valid(status), px, F(np.nan)), filled.sigma_px, status)
