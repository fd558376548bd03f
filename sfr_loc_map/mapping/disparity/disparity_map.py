"""The disparity map of a stereo pair, which the stages of `Mapper.process` take and return.

As estimated, all valid disparities are measured. `fill_holes` makes more of them valid, whose disparities are those of
the surfaces beside them. `without_roll` changes disparities, and `within_range` makes the smallest ones invalid.
"""

from __future__ import annotations

from dataclasses import dataclass

from sfr_loc_map.geometry.arrays import FloatImage, Mask
from sfr_loc_map.mapping.disparity.pixel_status import StatusImage, is_valid
from sfr_loc_map.mapping.disparity.right_image_correction import RightImageCorrection
from sfr_loc_map.mapping.disparity.saturation import Saturation


@dataclass(frozen=True, slots=True, eq=False)
class DisparityMap:
    """Disparities of the left image with their uncertainty, and the images that they were estimated from."""

    #: `(H, W)` float32, pixels, defined at every pixel. Where the status is invalid, it only continues the initial
    #: disparities around it smoothly. It fits the right image, unless `without_roll` has changed it.
    px: FloatImage
    sigma_px: FloatImage  #: `(H, W)` float32, standard deviation of a valid disparity, pixels.
    status: StatusImage  #: `(H, W)` uint8, measured, filled, or the reason why the disparity is invalid.
    initial_px: FloatImage  #: `(H, W)` float32, disparities of the semi-global matching, pixels; NaN where it has none.
    left: FloatImage  #: `(H, W)` float32, left image, grey levels.
    right: FloatImage  #: `(H, W)` float32, right image after its correction, grey levels.
    correction: RightImageCorrection  #: The deviations that were removed from the right image.
    saturation: Saturation  #: Saturation of both images.
    noise_grey: float  #: Standard deviation of a photometric residual, grey levels.
    #: Fraction of the textured pixels whose disparity is measured; NaN if too few are textured.
    measured_textured_fraction: float

    @property
    def valid(self) -> Mask:
        """Which pixels `(H, W)` have a disparity, measured or filled."""
        return is_valid(self.status)
