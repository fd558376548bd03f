"""The disparity map of a stereo pair: `estimate_disparity`, which calls `refine_pair` for the stages up to sigma.

=====================================  ================================================================================
stage                                  method
=====================================  ================================================================================
matching costs, aggregation,           semi-global matching (Hirschmueller 2008); wide images at half their width
left-right check
correction of the right image          exposure and vertical disparity of the right image are measured and removed
refinement                             one field of disparities on cells of 2 x 2 pixels is fitted to both images by
                                       photometric residuals and weighted second differences (variational, after Horn
                                       and Schunck 1981), coarse to fine by conjugate gradients
sigma                                  posterior of the field, smoothing bias, and the error beside creases
validity                               tests of each pixel (`PixelStatus`); beside disparity jumps, a small network
                                       compares matching costs with adaptive support weights (Yoon and Kweon 2006)
match check                            a pair with too few measured textured pixels is refused
rotation of the right camera           yaw, pitch and roll from the vertical disparity at measured pixels
holes                                  invalid pixels take the disparity of a surface beside them if both images
                                       support it
roll and range                         the effect of the roll is removed; pixels beyond the maximum depth become invalid
=====================================  ================================================================================
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sfr_loc_map.geometry.arrays import F, FloatImage
from sfr_loc_map.geometry.camera import StereoCamera
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.mapping.disparity.cell_field import cells_from_disparity, disparity_from_cells
from sfr_loc_map.mapping.disparity.hole_filling import fill_holes
from sfr_loc_map.mapping.disparity.match_check import check_matches, measured_textured_fraction
from sfr_loc_map.mapping.disparity.right_camera import CameraRotation, measure_right_rotation, roll_error_px
from sfr_loc_map.mapping.disparity.right_image_correction import RightImageCorrection, correct_right_image
from sfr_loc_map.mapping.disparity.saturation import Saturation, measure_saturation
from sfr_loc_map.mapping.disparity.search_range import SearchRange
from sfr_loc_map.mapping.disparity.semi_global_matching import semi_global_matching
from sfr_loc_map.mapping.disparity.surfaces import DisparityScene
from sfr_loc_map.mapping.disparity.uncertainty import disparity_sigma
from sfr_loc_map.mapping.disparity.validity import PixelStatus, StatusImage, is_valid, judge_pixels, with_reason
from sfr_loc_map.mapping.disparity.variational_refinement import RefinedDisparity, refine_disparity
from sfr_loc_map.mapping.filters import local_variance


@dataclass(frozen=True, slots=True, eq=False)
class DisparityMap:
    """Disparities of the left image, and what the images of the pair show about their cameras.

    The disparities are those of a right camera without roll. If the camera has a roll, they do not fit its image.
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

    After holes are filled, `status` alone records which pixels are valid. To reject pixels there, call `with_reason`
    with their mask, as for BEYOND_RANGE.

    Raises MappingError if the images do not match, before holes are filled.
    """
    scene, refined, correction = refine_pair(pair, rig.camera, search.count)

    saturation = measure_saturation(pair.left, pair.right, scene.disparity)
    left_variance = local_variance(scene.left)
    status = judge_pixels(scene, refined, left_variance, saturation.square_saturated)
    scene = scene._replace(valid=is_valid(status))
    fraction = measured_textured_fraction(scene.left, left_variance, scene.valid)
    check_matches(pair, fraction, search.count)

    rotation = measure_right_rotation(scene, correction.vertical, rig)

    filled = fill_holes(scene, saturation.square_saturated, refined.noise_grey)
    status = np.where(filled.valid & ~scene.valid, np.uint8(PixelStatus.FILLED), status)
    px = filled.disparity - roll_error_px(rotation, rig)
    status = with_reason(status, px < search.min_disparity_px, PixelStatus.BEYOND_RANGE)
    return DisparityMap(
        px=np.where(is_valid(status), px, F(np.nan)),
        sigma_px=filled.sigma,
        status=status,
        left=scene.left,
        noise_grey=refined.noise_grey,
        measured_textured_fraction=fraction,
        saturation=saturation,
        correction=correction,
        rotation=rotation,
    )


def refine_pair(
    pair: StereoPair, camera: StereoCamera, disparity_count: int
) -> tuple[DisparityScene, RefinedDisparity, RightImageCorrection]:
    """Return the scene of a pair, its refined disparity, and the deviations that were removed from the right image.

    The search is over `disparity_count` integer disparities from 0. The valid pixels of the scene are those that the
    semi-global matching has matched.

    The stages up to sigma are a separate function, because `tools/train_jump_network.py` and
    `tools/error_bounds.py` call them, too.
    """
    left = pair.left.astype(F, order="C")  # the kernels are compiled for this order
    right = pair.right.astype(F, order="C")
    matched_px = semi_global_matching(pair.left, pair.right, disparity_count)
    initial_cells = cells_from_disparity(matched_px)

    initial_px = disparity_from_cells(initial_cells, left.shape)
    right, correction = correct_right_image(left, right, initial_px, camera)

    refined = refine_disparity(left, right, initial_cells)
    scene = DisparityScene(
        left=left,
        right=right,
        matched=matched_px,
        disparity=refined.disparity_px,
        sigma=disparity_sigma(refined),
        valid=np.isfinite(matched_px),
    )
    return scene, refined, correction
