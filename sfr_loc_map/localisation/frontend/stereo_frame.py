"""A stereo pair, prepared for tracking."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import GreyImage
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.localisation.frontend.pyramid import Pyramid, build_pyramid
from sfr_loc_map.parallel import both

MIN_TEXTURE = 1.0
"""Minimum standard deviation of the coarsest pyramid level of a textured image, grey levels. Image noise of 8 grey
levels has a standard deviation of 1 after averaging over 8 x 8 px."""


class StereoFrame(NamedTuple):
    """A stereo pair, prepared for tracking."""

    stamp_ns: int  #: Stamp of the pair.
    image: GreyImage  #: `(H, W)` uint8, left image with its stale parts blanked.
    left: Pyramid  #: Pyramid of the left image.
    right: Pyramid  #: Pyramid of the right image.
    #: Whether both images have texture. Stale parts count, because only the localiser blanked them.
    is_textured: bool
    has_frozen_image: bool  #: Whether one image is frozen, and therefore blanked.

    @classmethod
    def of(cls, pair: StereoPair, received: StereoPair | None = None, *, has_frozen_image: bool = False) -> StereoFrame:
        """Build the pyramids of a pair, each image in its own thread.

        `received` is the pair before its stale parts were blanked; None if nothing was blanked.
        """
        received = received or pair
        left, right = both(build_pyramid, (pair.left,), (pair.right,))
        received_left = left if received.left is pair.left else build_pyramid(received.left)
        received_right = right if received.right is pair.right else build_pyramid(received.right)
        textured = is_textured(received_left) and is_textured(received_right)
        return cls(pair.stamp_ns, pair.left, left, right, textured, has_frozen_image)


def is_textured(image: Pyramid) -> bool:
    """Return whether an image has texture; a black, white or overexposed image has none."""
    return float(np.std(image[-1].image)) > MIN_TEXTURE
