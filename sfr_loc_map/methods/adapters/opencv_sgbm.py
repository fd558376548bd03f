"""OpenCV's semi-global matching with common settings: three-way mode, block size 3, images padded on the left."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from sfr_loc_map.methods.child.loop import Answer, Order, Setup

BLOCK = 3


class OpenCvStereo:
    """Disparities of the left image, NaN where invalid."""

    version = cv2.__version__

    def __init__(self, setup: Setup) -> None:
        self._count = setup["disparities"]
        smoothness = {"P1": 8 * BLOCK * BLOCK, "P2": 32 * BLOCK * BLOCK, "uniquenessRatio": 10}
        speckles = {"disp12MaxDiff": 1, "preFilterCap": 31, "speckleWindowSize": 100, "speckleRange": 2}
        size = {"minDisparity": 0, "numDisparities": self._count, "blockSize": BLOCK}
        self._matcher = cv2.StereoSGBM.create(**size, **smoothness, **speckles, mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY)
        shape = (setup["camera"]["height"], setup["camera"]["width"])
        noise = np.random.default_rng(0).integers(0, 255, shape).astype(np.uint8)
        self._match(noise, np.roll(noise, -4, 1))

    def _match(self, left: NDArray[np.uint8], right: NDArray[np.uint8]) -> NDArray[np.float32]:
        padded = [cv2.copyMakeBorder(image, 0, 0, self._count, 0, cv2.BORDER_REPLICATE) for image in (left, right)]
        sixteenths = self._matcher.compute(padded[0], padded[1])[:, self._count :]
        return np.where(sixteenths < 0, np.float32(np.nan), sixteenths.astype(np.float32) / np.float32(16.0))

    def prepare(
        self, left: NDArray[np.uint8], right: NDArray[np.uint8], order: Order
    ) -> Callable[[], NDArray[np.float32]]:
        """Return the call."""
        return lambda: self._match(left, right)

    def report(self, answer: NDArray[np.float32], order: Order) -> Answer:
        """Save the disparities."""
        np.save(order["output"] + ".disparity.npy", answer)
        return {}


open_method = OpenCvStereo
