"""The bounds of the pixels and pair numbers of points.

The adapter of libraries checks them in the method's process, because it looks up the intensity of the pixels and stores
pair numbers in fewer bits. The client checks them in all answers, because it does not trust that process.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def check_points(
    u: NDArray[np.unsignedinteger],
    v: NDArray[np.unsignedinteger],
    pair: NDArray[np.unsignedinteger],
    shape: tuple[int, int, int],
) -> None:
    """Raise ValueError if a point is not in the images of the pairs; `shape` is number, height and width."""
    if not len(u):
        return
    pairs, height, width = shape
    if u.max() >= width or v.max() >= height:
        raise ValueError(f"the pixel of a point is outside of the image of {width} x {height} pixels")
    if pair.max() >= pairs:
        raise ValueError(f"a point has the pair number {pair.max()}: 0 to {pairs - 1} is required")
