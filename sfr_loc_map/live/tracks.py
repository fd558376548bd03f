"""Masks as outlines that a screen can draw."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray32

TOPIC = "localisation/tracks"
MAX_OUTLINES, MAX_CORNERS = 40, 200
TOLERANCE_PX = 0.7
"""Largest distance of an outline from the edge of a mask, pixels of the mask."""


def outlines(mask: NDArray[np.uint8], scale: float) -> tuple[FloatArray32, ...]:
    """Return the largest outlines `(K, 2)` of where a mask is 0, pixels of the image.

    Args:
        mask: `(H, W)`.
        scale: Pixels of the image for one of the mask.
    """
    found, _ = cv2.findContours((mask == 0).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    largest = sorted(found, key=cv2.contourArea, reverse=True)[:MAX_OUTLINES]
    corners = (cv2.approxPolyDP(ring, TOLERANCE_PX, True).reshape(-1, 2)[:MAX_CORNERS] for ring in largest)
    return tuple((ring.astype(np.float32) + 0.5) * np.float32(scale) - 0.5 for ring in corners)
