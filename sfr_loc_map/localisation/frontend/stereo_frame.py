"""A stereo pair, prepared for tracking."""

from __future__ import annotations

from dataclasses import replace
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

    pair: StereoPair  #: The pair with its stale parts blanked.
    received: StereoPair  #: The pair as it was received.
    left: Pyramid  #: Pyramid of the left image.
    right: Pyramid  #: Pyramid of the right image.
    has_frozen_image: bool  #: Whether one image is frozen, and therefore blanked.

    @classmethod
    def of(cls, pair: StereoPair, received: StereoPair | None = None, *, has_frozen_image: bool = False) -> StereoFrame:
        """Build the pyramids of a pair, each image in its own thread.

        `received` is the pair before its stale parts were blanked; None if nothing was blanked.
        """
        left, right = both(build_pyramid, (pair.left,), (pair.right,))
        return cls(pair, received or pair, left, right, has_frozen_image)

    def swapped(self) -> StereoFrame:
        """Return the frame with its left and right images exchanged."""
        pair = replace(self.pair, left=self.pair.right, right=self.pair.left)
        received = replace(self.received, left=self.received.right, right=self.received.left)
        return StereoFrame(pair, received, self.right, self.left, self.has_frozen_image)

    @property
    def stamp_ns(self) -> int:
        """Stamp of the pair."""
        return self.pair.stamp_ns

    @property
    def image(self) -> GreyImage:
        """Left image `(H, W)` uint8 with its stale parts blanked."""
        return self.pair.left

    def was_received_textured(self) -> bool:
        """Return whether both images have texture as received: with stale parts, which the localiser has blanked."""
        return all(is_textured(build_pyramid(image)) for image in (self.received.left, self.received.right))


def is_textured(image: Pyramid) -> bool:
    """Return whether an image has texture; a black, white or overexposed image has none."""
    return float(np.std(image[-1].image)) > MIN_TEXTURE
