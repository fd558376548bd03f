"""A stereo pair that a fault affects, and how its images are changed: moved, with noise, rounded to grey levels."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np

from sfr_loc_map.faults.kinds import Fault
from sfr_loc_map.geometry.arrays import FloatArray, FloatImage, GreyImage
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig

READ_NOISE = 1.0  #: Noise of a camera that is left when no light comes in, grey levels.


class Moment(NamedTuple):
    """One affected pair."""

    progress: float  #: How much of its burst is over, 0 .. 1.
    pair: int  #: Its number.
    spot: FloatArray  #: `(2,)` random point, as shares of width and height.
    rng: np.random.Generator  #: Generator of this pair.


@dataclass(frozen=True, slots=True, eq=False)
class Affected:
    """A pair that a fault affects, and all that its change depends on."""

    fault: Fault
    pair: StereoPair  #: As the fault finds it.
    previous: StereoPair | None  #: The last new pair as the fault found it, None before the first.
    following: StereoPair | None  #: The next pair, None after the last.
    moment: Moment
    rig: StereoRig  #: The true one.
    fixed: np.random.Generator  #: Generator that is the same for all pairs of a drive.

    @property
    def amount(self) -> float:
        """How strong the fault is, in the unit of its kind."""
        return self.fault.amount

    def with_images(self, left: GreyImage, right: GreyImage) -> StereoPair:
        """Return the pair with other images of the affected cameras."""
        if self.fault.camera == "right":
            left = self.pair.left
        elif self.fault.camera == "left":
            right = self.pair.right
        return replace(self.pair, left=left, right=right)


def with_noise(grey: FloatImage, sigma: float, rng: np.random.Generator) -> GreyImage:
    """Return grey levels `(H, W)` with Gaussian noise, rounded and clipped."""
    return as_grey(grey + sigma * rng.standard_normal(grey.shape, np.float32))


def as_grey(values: FloatArray | FloatImage) -> GreyImage:
    """Return grey levels rounded and clipped."""
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def moved(image: FloatImage, columns: float) -> FloatImage:
    """Return an image moved to the right by a part of a pixel too, mirrored at its edges."""
    return warped(image, np.array([[1.0, 0.0, columns], [0.0, 1.0, 0.0]]))


def warped(image: FloatImage, transform: FloatArray) -> FloatImage:
    """Return an image after an affine transform `(2, 3)`, mirrored at its edges."""
    flags, border = cv2.INTER_CUBIC, cv2.BORDER_REFLECT
    return np.asarray(cv2.warpAffine(image, transform, image.shape[::-1], flags=flags, borderMode=border), np.float32)
