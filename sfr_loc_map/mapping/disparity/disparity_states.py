"""The disparities of a stereo pair in three states, one type each. `Mapper.process` goes through them in this order.

1. `MeasuredDisparity` (`estimation.estimate_disparity`): all valid disparities are measured and fit the right image.
2. `FilledDisparity` (`hole_filling.fill_holes`): some holes are filled, and the disparities still fit the right image.
3. `FinalDisparity` (`final_disparity.final_disparity`): without the roll of the right camera and within the range. The
   points of the map follow from these disparities, which need not fit the right image.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from sfr_loc_map.geometry.arrays import FloatImage, Mask
from sfr_loc_map.mapping.disparity.pair_refinement import RefinedPair
from sfr_loc_map.mapping.disparity.pixel_status import StatusImage, is_valid
from sfr_loc_map.mapping.disparity.saturation import Saturation


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredDisparity:
    """Measured disparities of the left image with their uncertainty, and the images that they were measured in."""

    #: Images, disparities and sigma. At invalid pixels the disparity is only a smooth continuation of the disparities
    #: around them.
    pair: RefinedPair
    status: StatusImage  #: `(H, W)` uint8, measured, or the reason why the disparity is invalid.
    saturation: Saturation  #: Saturation of both images.
    #: Fraction of the textured pixels whose disparity is measured; NaN if too few are textured.
    measured_textured_fraction: float

    @property
    def valid(self) -> Mask:
        """Mask `(H, W)` of the measured pixels."""
        return is_valid(self.status)


class FilledDisparity(NamedTuple):
    """Measured and filled disparities."""

    px: FloatImage  #: `(H, W)` float32, pixels, defined at every pixel like those of `MeasuredDisparity`.
    sigma_px: FloatImage  #: `(H, W)` float32, standard deviation of a valid disparity, pixels.
    status: StatusImage  #: `(H, W)` uint8, measured, filled, or the reason why the disparity is invalid.


class FinalDisparity(NamedTuple):
    """Disparities of the map."""

    px: FloatImage  #: `(H, W)` float32, pixels; NaN where invalid.
    sigma_px: FloatImage  #: `(H, W)` float32, standard deviation of a valid disparity, pixels.
    status: StatusImage  #: `(H, W)` uint8, measured, filled, or the reason why the disparity is invalid.
