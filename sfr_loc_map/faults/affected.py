"""The inputs of a fault function, and operations on images that fault functions share."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from sfr_loc_map.faults.kinds import Fault
from sfr_loc_map.geometry.arrays import FloatArray, FloatImage, GreyImage
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig

READ_NOISE = 1.0  #: Noise of a camera without light, grey levels.


@dataclass(frozen=True, slots=True, eq=False)
class Affected:
    """The inputs of a fault function: the affected pair, the previous pair, the next stamp and random values."""

    fault: Fault
    pair: StereoPair  #: The pair with the faults that precede this fault in the order of the faults.
    #: The last earlier pair that is not a repetition, with the same preceding faults; None for the first pair.
    previous: StereoPair | None
    following_ns: int | None  #: Stamp of the next pair of the source, with faults of the clock; None after the last.
    rig: StereoRig  #: The true rig.
    index: int  #: Index of the pair in the source.
    progress: float  #: Elapsed fraction of the burst, 0 to 1; exceeds 1 for kinds without bursts.
    spot: FloatArray  #: `(2,)` random point, as fractions of width and height.
    pair_rng: np.random.Generator  #: Random generator of the pair.
    drive_rng: np.random.Generator  #: Random generator with the same seed for all pairs of a drive.

    @property
    def amount(self) -> float:
        """Strength of the fault, in the unit of the kind."""
        return self.fault.amount

    def with_images(self, left: GreyImage, right: GreyImage) -> StereoPair:
        """Return the pair with new images of the affected cameras."""
        if self.fault.camera == "right":
            left = self.pair.left
        elif self.fault.camera == "left":
            right = self.pair.right
        return replace(self.pair, left=left, right=right)


def with_noise(grey: FloatImage, sigma: float, rng: np.random.Generator) -> GreyImage:
    """Return grey levels `(H, W)` with Gaussian noise, rounded and clipped."""
    return as_grey(grey + sigma * rng.standard_normal(grey.shape, np.float32))


def as_grey(values: FloatArray | FloatImage) -> GreyImage:
    """Return rounded and clipped grey levels."""
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def moved(image: FloatImage, columns: float) -> FloatImage:
    """Return an image shifted to the right by a number of columns, which may be fractional; edges are mirrored."""
    return warped(image, np.array([[1.0, 0.0, columns], [0.0, 1.0, 0.0]]))


def warped(image: FloatImage, transform: FloatArray) -> FloatImage:
    """Return an image after an affine transform `(2, 3)`; edges are mirrored."""
    flags, border = cv2.INTER_CUBIC, cv2.BORDER_REFLECT
    return np.asarray(cv2.warpAffine(image, transform, image.shape[::-1], flags=flags, borderMode=border), np.float32)
