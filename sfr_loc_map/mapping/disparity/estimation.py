"""The disparity map of a stereo pair: `estimate_disparity`.

    pair
      │
      ▼
    matching             semi_global_matching.py   search range, matching costs, aggregation, left-right check, with
      │                                            equal exposures (exposure.py)
      │ matched disparity, NaN where unmatched
      ▼
    right image          right_camera/             exposure and vertical disparity are measured and removed
      │ corrected right image
      ▼
    refinement           refinement/               one field is fitted to both images; its standard deviation
      │ disparity and sigma of every pixel
      ▼
    validity             validity/                 tests of each pixel; a pair that does not match is refused
      │ status of every pixel                      (match_check.py)
      ▼
    right camera         right_camera/             its rotation, from the vertical disparity at measured pixels
      │ rotation
      ▼
    holes                hole_filling.py           invalid pixels take the disparity of a surface beside them
      │
      ▼
    DisparityMap         without the effect of the roll of the right camera, and without pixels beyond the maximum depth

`surfaces` contains functions for jumps, slopes and occlusions, and `DisparityScene`: the images and disparities that
validity, right camera and holes use. `matching_cost` computes how well a pixel matches at a disparity, for the
network of `validity` and for the filling of holes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sfr_loc_map.geometry.arrays import F, FloatImage
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.mapping.disparity.hole_filling import fill_holes
from sfr_loc_map.mapping.disparity.match_check import check_matches, measured_textured_fraction
from sfr_loc_map.mapping.disparity.refinement.cell_field import cells_from_disparity, disparity_from_cells
from sfr_loc_map.mapping.disparity.refinement.variational_refinement import refine_disparity
from sfr_loc_map.mapping.disparity.right_camera.right_image_correction import RightImageCorrection, correct_right_image
from sfr_loc_map.mapping.disparity.right_camera.rotation import CameraRotation, measure_right_rotation, roll_error_px
from sfr_loc_map.mapping.disparity.semi_global_matching import SearchRange, semi_global_matching
from sfr_loc_map.mapping.disparity.surfaces import DisparityScene
from sfr_loc_map.mapping.disparity.validity.pixel_status import (
    PixelStatus,
    StatusImage,
    is_valid,
    judge_pixels,
    with_reason,
)
from sfr_loc_map.mapping.disparity.validity.saturation import Saturation, measure_saturation
from sfr_loc_map.mapping.filters import local_variance, with_value


@dataclass(frozen=True, slots=True, eq=False)
class DisparityMap:
    """Disparities of the left image, and what the images of the pair show about their cameras.

    The effect of a roll of the right camera is removed from the disparities. If the camera has a roll, the disparities
    therefore do not fit its image.
    """

    px: FloatImage  #: `(H, W)` float32, pixels; NaN where invalid.
    sigma_px: FloatImage  #: `(H, W)` float32, standard deviation of a valid disparity, pixels.
    status: StatusImage  #: `(H, W)` uint8, measured, filled, or the reason why the disparity is invalid.
    left: FloatImage  #: `(H, W)` float32, grey levels of the left image.
    noise_grey: float  #: Standard deviation of a photometric residual, grey levels.
    #: Fraction of the textured pixels whose disparity is measured; NaN if too few are textured.
    measured_textured_fraction: float
    saturation: Saturation  #: Saturation of both images.
    correction: RightImageCorrection  #: Exposure and vertical disparity that were removed from the right image.
    rotation: CameraRotation  #: Rotation of the right camera relative to its calibration.


def estimate_disparity(pair: StereoPair, rig: StereoRig, search: SearchRange) -> DisparityMap:
    """Return the disparity map of a pair.

    Raises MappingError if the images do not match, before holes are filled.
    """
    left = pair.left.astype(F, order="C")  # the kernels are compiled for this order
    right = pair.right.astype(F, order="C")

    # Matching
    matched_px = semi_global_matching(pair.left, pair.right, search.count)
    initial_cells = cells_from_disparity(matched_px)

    # Right image: exposure and vertical disparity are removed
    initial_px = disparity_from_cells(initial_cells, left.shape)
    right, correction = correct_right_image(left, right, initial_px, rig.camera)

    # Refinement
    refined = refine_disparity(left, right, initial_cells)

    # Validity
    saturation = measure_saturation(pair.left, pair.right, refined.px)
    left_variance = local_variance(left)
    matched = DisparityScene(left, right, matched_px, refined.px, refined.sigma_px, valid=np.isfinite(matched_px))
    measured, status = judge_pixels(matched, refined, left_variance, saturation.square_saturated)
    fraction = measured_textured_fraction(left, left_variance, measured.valid)
    check_matches(pair, fraction, search.count)

    # Right camera
    rotation = measure_right_rotation(measured, correction.vertical, rig)

    # Holes
    filled = fill_holes(measured, saturation.square_saturated, refined.noise_grey)
    status = with_value(np.uint8(PixelStatus.FILLED), filled.valid & ~measured.valid, status)

    # From here on, only the status records which pixels are valid.
    px = filled.disparity - roll_error_px(rotation, rig)
    status = with_reason(status, px < search.min_disparity_px, PixelStatus.BEYOND_RANGE)
    return DisparityMap(
        px=with_value(F(np.nan), ~is_valid(status), px),
        sigma_px=filled.sigma,
        status=status,
        left=left,
        noise_grey=refined.noise_grey,
        measured_textured_fraction=fraction,
        saturation=saturation,
        correction=correction,
        rotation=rotation,
    )
