"""Estimation of the disparity map of a stereo pair, before invalid pixels are filled.

The steps of `estimate_disparity`, with their modules in `disparity` and their results:

1. `semi_global_matching` (`semi_global_matching`, `exposure`) -> disparity `(H, W)`, NaN at unmatched pixels: initial
   disparity by semi-global matching (Hirschmueller 2008). Wide images are matched at half their width.
2. `cells_from_disparity` (`cell_field`) -> field on cells of 2 x 2 pixels, defined everywhere: unmatched cells take the
   disparity of the farther neighbour along the row. `disparity_from_cells` interpolates the field at each pixel.
3. `correct_right_image` (`right_image_correction`, `exposure`, `vertical_disparity`) -> `CorrectedImage`: exposure and
   vertical disparity of the right image are measured and removed.
4. `refine_disparity` (`variational_refinement`, `photometric_residual`, `image_noise`, `roughness`,
   `smoothness`, `conjugate_gradients`) -> `RefinedDisparity`: one disparity field is fitted to both images by
   photometric residuals and weighted second differences over the whole image (variational, after Horn and Schunck
   1981), solved coarse to fine by conjugate gradients.
5. `disparity_sigma` (`uncertainty`) -> sigma `(H, W)`: standard deviation from the posterior of the field, the
   smoothing bias and the error beside creases.
6. `measure_saturation` (`saturation`) -> `Saturation`: the saturated pixels of both images.
7. `judge_pixels` (`validity`, `surfaces`, `segments`, `wrong_surface`, `matching_cost`) -> status `(H, W)`: measured,
   or the reason why a pixel is invalid: unmatched, changed by the refinement, occluded, mismatched, on a ramp, in a
   segment that is small or has no content in common with the right image, on the wrong surface beside a jump
   (classified by a small network from matching costs with adaptive support weights, Yoon and Kweon 2006), or saturated.
8. `measured_textured_fraction` (`texture`) -> number: the fraction of the textured pixels that are measured.
"""

from __future__ import annotations

from sfr_loc_map.geometry.arrays import F
from sfr_loc_map.geometry.camera import StereoCamera
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.mapping.disparity.cell_field import cells_from_disparity, disparity_from_cells
from sfr_loc_map.mapping.disparity.disparity_map import DisparityMap
from sfr_loc_map.mapping.disparity.pixel_status import is_valid
from sfr_loc_map.mapping.disparity.right_image_correction import correct_right_image
from sfr_loc_map.mapping.disparity.saturation import measure_saturation
from sfr_loc_map.mapping.disparity.semi_global_matching import semi_global_matching
from sfr_loc_map.mapping.disparity.texture import measured_textured_fraction
from sfr_loc_map.mapping.disparity.uncertainty import disparity_sigma
from sfr_loc_map.mapping.disparity.validity import judge_pixels
from sfr_loc_map.mapping.disparity.variational_refinement import refine_disparity
from sfr_loc_map.mapping.filters import local_variance


def estimate_disparity(pair: StereoPair, camera: StereoCamera, disparity_count: int) -> DisparityMap:
    """Return the disparity map of a pair from a search over `disparity_count` integer disparities from 0."""
    left = pair.left.astype(F, order="C")  # the kernels are compiled for this order
    initial_px = semi_global_matching(pair.left, pair.right, disparity_count)
    initial_cells = cells_from_disparity(initial_px)
    dense_px = disparity_from_cells(initial_cells, left.shape)
    corrected = correct_right_image(left, pair.right.astype(F, order="C"), dense_px, camera)
    right = corrected.image
    refined = refine_disparity(left, right, initial_cells)
    sigma_px = disparity_sigma(refined)
    saturation = measure_saturation(pair.left, pair.right, refined.disparity_px)
    left_variance = local_variance(left)
    status = judge_pixels(left, left_variance, right, initial_px, refined, sigma_px, saturation)
    return DisparityMap(
        px=refined.disparity_px,
        sigma_px=sigma_px,
        status=status,
        initial_px=initial_px,
        left=left,
        right=right,
        correction=corrected.correction,
        saturation=saturation,
        noise_grey=refined.noise_grey,
        measured_textured_fraction=measured_textured_fraction(left, left_variance, is_valid(status)),
    )
