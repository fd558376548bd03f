"""The refined disparity of a stereo pair, before its pixels are judged: steps 1 to 5 of `estimation`."""

from __future__ import annotations

from typing import NamedTuple

from sfr_loc_map.geometry.arrays import F, FloatImage
from sfr_loc_map.geometry.camera import StereoCamera
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.mapping.disparity.cell_field import cells_from_disparity, disparity_from_cells
from sfr_loc_map.mapping.disparity.right_image_correction import RightImageCorrection, correct_right_image
from sfr_loc_map.mapping.disparity.semi_global_matching import semi_global_matching
from sfr_loc_map.mapping.disparity.uncertainty import disparity_sigma
from sfr_loc_map.mapping.disparity.variational_refinement import RefinedDisparity, refine_disparity


class RefinedPair(NamedTuple):
    """The images of a pair and their refined disparity; images are `(H, W)` float32."""

    left: FloatImage  #: Left image, grey levels.
    right: FloatImage  #: Right image after its correction, grey levels.
    correction: RightImageCorrection  #: The deviations that were removed from the right image.
    initial_px: FloatImage  #: Disparities of the semi-global matching, pixels; NaN if unmatched.
    field: RefinedDisparity  #: The refined disparity, its residuals and its noise.
    sigma_px: FloatImage  #: Standard deviation of the refined disparity, pixels.

    @property
    def px(self) -> FloatImage:
        """The refined disparity, pixels, defined everywhere."""
        return self.field.disparity_px


def refine_pair(pair: StereoPair, camera: StereoCamera, disparity_count: int) -> RefinedPair:
    """Return the refined disparity of a pair from a search over `disparity_count` integer disparities from 0."""
    left = pair.left.astype(F, order="C")  # the kernels are compiled for this order
    initial_px = semi_global_matching(pair.left, pair.right, disparity_count)
    initial_cells = cells_from_disparity(initial_px)
    dense_px = disparity_from_cells(initial_cells, left.shape)
    corrected = correct_right_image(left, pair.right.astype(F, order="C"), dense_px, camera)
    field = refine_disparity(left, corrected.image, initial_cells)
    return RefinedPair(
        left=left,
        right=corrected.image,
        correction=corrected.correction,
        initial_px=initial_px,
        field=field,
        sigma_px=disparity_sigma(field),
    )
