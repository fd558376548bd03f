"""The disparity map of a stereo pair, which the stages of `Mapper.process` take and return.

In the map that `estimate_disparity` returns, all valid disparities are measured. `fill_holes` makes more pixels valid
by extrapolating adjacent surfaces. `without_roll` changes disparities, and `within_range` makes the smallest
disparities invalid.
"""

from __future__ import annotations

from dataclasses import dataclass

from sfr_loc_map.geometry.arrays import FloatImage, Mask
from sfr_loc_map.mapping.disparity.pixel_status import StatusImage, is_valid
from sfr_loc_map.mapping.disparity.right_image_correction import RightImageCorrection
from sfr_loc_map.mapping.disparity.saturation import Saturation


@dataclass(frozen=True, slots=True, eq=False)
class DisparityMap:
    """Disparities of the left image with their uncertainty, and the images from which they were estimated."""

    #: `(H, W)` float32, pixels, defined at every pixel. At invalid pixels the value is only a smooth continuation of
    #: the disparities around them. The disparities fit the right image unless `without_roll` has changed them.
    px: FloatImage
    sigma_px: FloatImage  #: `(H, W)` float32, standard deviation of a valid disparity, pixels.
    status: StatusImage  #: `(H, W)` uint8, measured, filled, or the reason why the disparity is invalid.
    #: `(H, W)` float32, disparities of the semi-global matching, pixels; NaN if unmatched. `without_roll` does not
    #: change these disparities.
    initial_px: FloatImage
    left: FloatImage  #: `(H, W)` float32, left image, grey levels.
    right: FloatImage  #: `(H, W)` float32, right image after its correction, grey levels.
    correction: RightImageCorrection  #: The deviations that were removed from the right image.
    saturation: Saturation  #: Saturation of both images.
    noise_grey: float  #: Standard deviation of a photometric residual, grey levels.
    #: Fraction of the textured pixels whose disparity is measured; NaN if too few are textured.
    measured_textured_fraction: float

    @property
    def valid(self) -> Mask:
        """Mask `(H, W)` of the pixels with a measured or filled disparity."""
        return is_valid(self.status)
