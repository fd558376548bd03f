"""Measurement of the disparities of a stereo pair, before invalid pixels are filled.

`refine_pair` (`pair_refinement`) calls steps 1 to 5. The result, `RefinedPair`, has no judged pixels yet.

The steps of `estimate_disparity`, with their modules in `disparity` and their results:

1. `semi_global_matching` (`semi_global_matching`, `exposure`) -> disparity `(H, W)`, NaN at unmatched pixels: initial
   disparity by semi-global matching (Hirschmueller 2008). Wide images are matched at half their width.
2. `cells_from_disparity` (`cell_field`) -> field on cells of 2 x 2 pixels, defined everywhere: unmatched cells take the
   disparity of the farther neighbour along the row. `disparity_from_cells` interpolates the field at each pixel.
3. `correct_right_image` (`right_image_correction`, `exposure`, `vertical_disparity`) -> `CorrectedImage`: exposure and
   vertical disparity of the right image are measured and removed.
4. `refine_disparity` (`variational_refinement`, `photometric_residual`, `image_noise`, `cauchy_scale`,
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

from sfr_loc_map.geometry.camera import StereoCamera
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.mapping.disparity.disparity_states import MeasuredDisparity
from sfr_loc_map.mapping.disparity.pair_refinement import refine_pair
from sfr_loc_map.mapping.disparity.pixel_status import is_valid
from sfr_loc_map.mapping.disparity.saturation import measure_saturation
from sfr_loc_map.mapping.disparity.texture import measured_textured_fraction
from sfr_loc_map.mapping.disparity.validity import judge_pixels
from sfr_loc_map.mapping.filters import local_variance


def estimate_disparity(pair: StereoPair, camera: StereoCamera, disparity_count: int) -> MeasuredDisparity:
    """Return the measured disparities of a pair from a search over `disparity_count` integer disparities from 0."""
    refined = refine_pair(pair, camera, disparity_count)
    saturation = measure_saturation(pair.left, pair.right, refined.px)
    left_variance = local_variance(refined.left)
    status = judge_pixels(refined, left_variance, saturation)
    return MeasuredDisparity(
        pair=refined,
        status=status,
        saturation=saturation,
        measured_textured_fraction=measured_textured_fraction(refined.left, left_variance, is_valid(status)),
    )
