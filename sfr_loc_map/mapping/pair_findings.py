"""Findings of one pair: statistics, and warnings about input that degrades the map.

Add a new finding of one pair here.
"""

from __future__ import annotations

import math

import numpy as np

from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.mapping.calibration_sigma import is_yaw_significant
from sfr_loc_map.mapping.config import CalibrationPrior
from sfr_loc_map.mapping.disparity.estimation import DisparityMap
from sfr_loc_map.mapping.disparity.match_check import MIN_MEASURED_FRACTION
from sfr_loc_map.mapping.disparity.right_camera.rotation import CameraRotation
from sfr_loc_map.mapping.disparity.semi_global_matching import SearchRange
from sfr_loc_map.mapping.disparity.validity.pixel_status import PixelStatus, StatusImage, is_valid
from sfr_loc_map.mapping.findings import Findings

LOW_MEASURED_FRACTION = 2.0 * MIN_MEASURED_FRACTION
"""Measured fraction of the textured pixels below which a warning is issued."""
MIN_VERTICAL_WARNING_PX = 0.3  #: Lower bound of the vertical disparity that causes a warning, pixels.
VERTICAL_WARNING_FACTOR = 3.0
"""Ratio of the vertical disparity to the configured residual distortion above which a warning is issued."""
COMPENSATED_PX = 1.0  #: Vertical disparity up to which the compensation is complete, pixels.
NEAR_LIMIT = 0.9
"""Disparities above this fraction of the largest searched disparity are near the limit of the search."""
MAX_NEAR_LIMIT_FRACTION = 0.04
"""Fraction of the measured pixels near the limit of the search above which a warning is issued, because the surface
probably continues beyond."""
MAX_BEYOND_FRACTION = 0.5
"""Fraction of the pixels with a disparity beyond the maximum depth above which a warning is issued."""
MAX_GAIN = 1.15  #: Gain, or inverse gain, above which a warning is issued: a fifth of a stop of exposure.
MAX_SATURATED_FRACTION = 0.1  #: Fraction of saturated pixels above which a warning is issued.


def findings_of_pair(disparity: DisparityMap, rig: StereoRig, prior: CalibrationPrior, search: SearchRange) -> Findings:
    """Return the findings of a pair, given the search range and the uncertainty of the calibration."""
    correction = disparity.correction
    rotation = disparity.rotation
    point_count = int(np.count_nonzero(is_valid(disparity.status)))
    filled_count = _count(disparity.status, PixelStatus.FILLED)
    statistics = {
        "points": float(point_count),
        "density": point_count / disparity.status.size,
        "filled_share": filled_count / max(point_count, 1),
        "noise_grey": disparity.noise_grey,
        "gain": correction.exposure.gain,
        "offset_grey": correction.exposure.offset_grey,
        "vertical_offset_px": correction.vertical.constant,
        "vertical_offset_largest_px": correction.vertical_largest_px,
        "matched_share": disparity.measured_textured_fraction,
        "right_yaw_deg": math.nan if rotation.yaw_sigma_rad is None else math.degrees(rotation.yaw_rad),
        "right_yaw_sigma_deg": math.nan if rotation.yaw_sigma_rad is None else math.degrees(rotation.yaw_sigma_rad),
        # Finite even if the rotation is not measured: the roll of the vertical disparity that was removed.
        "right_roll_deg": math.degrees(rotation.roll_rad),
        "saturated_share": disparity.saturation.fraction,
    }
    warnings = (
        *_warnings_of_points(disparity, point_count, search),
        *_warnings_of_images(disparity, prior),
        *_warnings_of_rotation(rotation, rig, prior),
    )
    return Findings(statistics, warnings)


def _count(status: StatusImage, value: PixelStatus) -> int:
    """Return the number of pixels with a status."""
    return int(np.count_nonzero(status == np.uint8(value)))


def vertical_warning_px(prior: CalibrationPrior) -> float:
    """Return the vertical disparity above which a warning is issued, pixels."""
    return max(MIN_VERTICAL_WARNING_PX, VERTICAL_WARNING_FACTOR * prior.distortion_px)


def _warnings_of_points(disparity: DisparityMap, point_count: int, search: SearchRange) -> list[str]:
    """Return warnings if the map has no points, or if the configured range probably excludes many."""
    beyond_count = _count(disparity.status, PixelStatus.BEYOND_RANGE)
    if point_count == 0 and beyond_count == 0:
        return ["the map has no points: no pixel has a valid disparity; check the images"]
    if point_count == 0:
        return [
            f"the map has no points: all {beyond_count} pixels with a disparity are beyond the maximum depth; increase "
            "max_range_m, or check the baseline"
        ]
    warnings = []
    is_measured = disparity.status == np.uint8(PixelStatus.MEASURED)
    measured_count = int(np.count_nonzero(is_measured))
    near_count = int(np.count_nonzero(is_measured & (disparity.px > NEAR_LIMIT * search.count)))
    if near_count > MAX_NEAR_LIMIT_FRACTION * measured_count:
        warnings.append(
            f"{100 * near_count / measured_count:.0f} % of the measured pixels are near the largest disparity of the "
            "search: nearer surfaces are probably not mapped; reduce min_range_m"
        )
    beyond_fraction = beyond_count / (beyond_count + point_count)
    if beyond_fraction > MAX_BEYOND_FRACTION:
        warnings.append(
            f"{100 * beyond_fraction:.0f} % of the pixels with a disparity are beyond the maximum depth and have "
            "no point; increase max_range_m, or check the baseline"
        )
    return warnings


def _warnings_of_images(disparity: DisparityMap, prior: CalibrationPrior) -> list[str]:
    """Return warnings about matches, rectification, exposure and saturation."""
    fraction = disparity.measured_textured_fraction
    correction = disparity.correction
    saturated = disparity.saturation.fraction
    warnings = []
    if math.isnan(fraction):
        warnings.append("too few pixels have texture above the noise: whether the images match is unknown")
    if fraction < LOW_MEASURED_FRACTION:
        warnings.append(
            f"only {100 * fraction:.0f} % of the textured pixels could be matched, {100 * LOW_MEASURED_FRACTION:.0f} % "
            "or more are usual: check that the images are rectified, taken at the same time and by this rig"
        )
    vertical_px = correction.vertical_largest_px
    if vertical_px > vertical_warning_px(prior):
        effect = "compensated" if vertical_px <= COMPENSATED_PX else "partly compensated, matches are lost"
        warnings.append(
            f"vertical disparity of up to {vertical_px:.2f} px between left and right ({effect}): "
            "check the rectification"
        )
    gain = correction.exposure.gain
    if not 1.0 / MAX_GAIN < gain < MAX_GAIN:
        warnings.append(f"the right image has {gain:.2f} times the contrast of the left (compensated)")
    if saturated > MAX_SATURATED_FRACTION:
        warnings.append(
            f"{100 * saturated:.0f} % of the pixels are saturated: saturated regions have no points, and sigma is "
            "larger beside them; change the exposure"
        )
    return warnings


def _warnings_of_rotation(rotation: CameraRotation, rig: StereoRig, prior: CalibrationPrior) -> list[str]:
    """Return a warning if the right camera has a significant yaw relative to its calibration."""
    if not is_yaw_significant(rotation, rig, prior):
        return []
    yaw_deg = math.degrees(rotation.yaw_rad)
    side = "right" if yaw_deg > 0 else "left"
    return [
        f"the right camera is probably rotated by {abs(yaw_deg):.3f} deg to the {side} (vertical disparity has the "
        "shape that a yaw causes): all depths share an error, and sigma is increased; calibrate the cameras"
    ]
