"""Patches: cut out of an image with their gradients, sampled, and normalised to zero mean."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage
from sfr_loc_map.jit import jit_fast, jit_fast_inline, jit_fast_ir_inline

HALF = 5
"""Half width of a patch: 11 x 11 pixels."""
SIDE = 2 * HALF + 1
Patch = NDArray[np.float32]
"""Values of one patch `(S * S,)` row by row, or of several; float32."""


@jit_fast_ir_inline
def sample(image: FloatImage, x: float | np.float32, y: float | np.float32) -> np.float32:
    """Return the bilinear value of an image at a position that is known to lie inside it."""
    # unsigned: for a signed index each read would test whether it counts from the end
    left, above, one = np.uintp(np.int32(x)), np.uintp(np.int32(y)), np.uintp(1)
    fx = np.float32(x - np.int32(x))
    fy = np.float32(y - np.int32(y))
    top: np.float32 = image[above, left] + fx * (image[above, left + one] - image[above, left])
    below = above + one
    bottom: np.float32 = image[below, left] + fx * (image[below, left + one] - image[below, left])
    return top + fy * (bottom - top)


@jit_fast_inline
def half_width(size: int) -> int:
    """Return the half width of a square patch of `size` pixels."""
    return (int(np.sqrt(size + 0.5)) - 1) // 2


@jit_fast
def cut_patches(image: FloatImage, uv: FloatArray, half: int) -> Patch:
    """Cut patches with their gradients.

    Args:
        image: `(H, W)` float32.
        uv: `(N, 2)` centres, pixels, at least half + 2 from the border.
        half: Half width.

    Returns:
        `(N, 3, S * S)` float32: grey levels and their derivatives along x and y, grey levels per pixel.
    """
    side = 2 * half + 1
    out = np.empty((len(uv), 3, side * side), np.float32)
    grid = np.empty((side + 2, side + 2), np.float32)
    for n in range(len(uv)):
        for j in range(side + 2):
            for i in range(side + 2):
                grid[j, i] = sample(image, uv[n, 0] + i - half - 1, uv[n, 1] + j - half - 1)
        k = 0
        for j in range(1, side + 1):
            for i in range(1, side + 1):
                out[n, 0, k] = grid[j, i]
                out[n, 1, k] = np.float32(0.5) * (grid[j, i + 1] - grid[j, i - 1])
                out[n, 2, k] = np.float32(0.5) * (grid[j + 1, i] - grid[j - 1, i])
                k += 1
    return out


@jit_fast_ir_inline
def normalise(values: Patch) -> np.float32:
    """Subtract the mean from values in place; return the sum of their squares."""
    mean = np.float32(0.0)
    for k in range(values.size):
        mean += values[k]
    mean /= np.float32(values.size)
    power = np.float32(0.0)
    for k in range(values.size):
        values[k] -= mean
        power += values[k] * values[k]
    return power
