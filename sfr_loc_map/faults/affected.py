"""The inputs of a change of images: affected and previous pair, options of the fault, and random values."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, GreyImage
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig


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
