"""What the changes of images share: their input (`Affected`), and operations on images.

Functions that require OpenCV import it, so that `kinds.parse_fault` does not load it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage, GreyImage
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig

READ_NOISE = 1.0  #: Noise of a camera without light, grey levels.


@dataclass(frozen=True, slots=True, eq=False)
class Affected:
    """An affected pair with the inputs of the function that changes its images."""

    pair: StereoPair  #: The pair with the faults that precede this fault in the order of the faults.
    #: The last earlier pair that is not a repetition, with the same preceding faults; None for the first pair.
    previous: StereoPair | None
    rig: StereoRig  #: The true rig.
    amount: float  #: Strength of the fault, in the unit of the kind.
    camera: str  #: Affected images: `both`, `left` or `right`.
    index: int  #: Index of the pair in the source.
    start: int  #: Index of the first pair that may be affected.
    progress: float  #: Fraction of the burst that has elapsed, 0 to 1. Meaningless for kinds without bursts.
    spot: FloatArray  #: `(2,)` random point, as fractions of width and height.
    pair_rng: np.random.Generator  #: Random generator of the pair.
    drive_rng: np.random.Generator  #: Random generator with the same seed for all pairs of a drive.

    def with_images(self, left: GreyImage, right: GreyImage) -> StereoPair:
        """Return the pair with new images of the affected cameras."""
        if self.camera == "right":
            left = self.pair.left
        elif self.camera == "left":
            right = self.pair.right
        return replace(self.pair, left=left, right=right)


Change = Callable[[Affected], StereoPair]
"""Returns the affected pair with the images of the fault; the stamp remains."""


def as_grey(values: FloatArray | FloatImage) -> GreyImage:
    """Return rounded and clipped grey levels."""
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def with_noise(grey: FloatImage, sigma: float, rng: np.random.Generator) -> GreyImage:
    """Return grey levels `(H, W)` with Gaussian noise, rounded and clipped."""
    return as_grey(grey + sigma * rng.standard_normal(grey.shape, np.float32))


def moved(image: FloatImage, columns: float) -> FloatImage:
    """Return an image shifted to the right by a number of columns, which may be fractional; edges are mirrored."""
    return warped(image, np.array([[1.0, 0.0, columns], [0.0, 1.0, 0.0]]))


def warped(image: FloatImage, transform: FloatArray) -> FloatImage:
    """Return an image after an affine transform `(2, 3)`; edges are mirrored."""
    import cv2

    flags, border = cv2.INTER_CUBIC, cv2.BORDER_REFLECT
    return np.asarray(cv2.warpAffine(image, transform, image.shape[::-1], flags=flags, borderMode=border), np.float32)


def smoothed(image: FloatImage, sigma_px: float) -> FloatImage:
    """Return an image after a Gaussian filter."""
    import cv2

    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma_px), np.float32)
