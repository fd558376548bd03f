"""The disparity map of a stereo pair: what each stage after the matching takes and returns.

The mapper has it in three states. As estimated, all valid disparities are measured. `fill_holes` makes more of them
valid, whose disparities are those of surfaces beside them. `without_roll` changes the disparities to those of a right
camera without a roll; they no longer fit the right image and are for points alone.
"""

from __future__ import annotations

from dataclasses import dataclass

from sfr_loc_map.geometry.arrays import FloatImage, Mask
from sfr_loc_map.mapping.disparity.right_image_correction import RightImageCorrection
from sfr_loc_map.mapping.disparity.saturation import Saturation


@dataclass(frozen=True, slots=True, eq=False)
class DisparityMap:
    """Disparities of the left image with their uncertainty, and the images that they were estimated from."""

    px: FloatImage  #: `(H, W)` float32, pixels, without holes; the invalid ones are interpolated.
    sigma_px: FloatImage  #: `(H, W)` float32, standard deviation of a valid disparity, pixels.
    valid: Mask  #: `(H, W)`, which disparities are valid: measured, or filled by `fill_holes`.
    initial_px: FloatImage  #: `(H, W)` float32, disparities of the semi-global matching, pixels; NaN where it has none.
    left: FloatImage  #: `(H, W)` float32, left image, grey levels.
    right: FloatImage  #: `(H, W)` float32, right image after its correction, grey levels.
    correction: RightImageCorrection  #: The deviations that were removed from the right image.
    saturation: Saturation  #: Saturation of both images.
    noise_grey: float  #: Standard deviation of a photometric residual, grey levels.
    #: Fraction of the textured pixels whose disparity is valid before holes are filled, in any state; NaN if too few
    #: are textured.
    valid_textured_fraction: float
