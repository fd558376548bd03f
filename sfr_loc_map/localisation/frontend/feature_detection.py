"""Feature detection: the strongest corner of each cell of a grid."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import ConfigError, GeometryError
from sfr_loc_map.geometry.arrays import FloatArray, FloatImage
from sfr_loc_map.geometry.plausibility import check_image_size
from sfr_loc_map.geometry.small_linalg import copy_row
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.inputs import read_bytes
from sfr_loc_map.jit import jit, jit_fast
from sfr_loc_map.localisation.parallel import both

BLOCK = 7  #: Side of the neighbourhood over which the gradients of a corner are summed, pixels.
MAX_MASK_BYTES = 64_000_000
_PNG_HEAD = re.compile(rb"\x89PNG\r\n\x1a\n.{4}IHDR(.{4})(.{4})", re.DOTALL)
"""Signature, and the header that comes first: width and height (ISO/IEC 15948, 11.2.2)."""


def find_corners(
    image: FloatImage, occupied: FloatArray, wanted: int, border: int, mask: NDArray[np.uint8] | None = None
) -> FloatArray:
    """Return new corners `(N, 2)`, whole pixels, the strongest first: one for each wanted cell without a landmark yet.

    The strength is the smaller eigenvalue of the gradient matrix (Shi and Tomasi 1994). Landmarks occupy pixels
    `(M, 2)`; no corner is taken within a border, pixels, or where the mask `(H, W)` is 0.
    """
    strength, middle = np.zeros_like(image), len(image) // 2
    both(_fill_strength, (image, strength, 0, middle), (image, strength, middle, len(image)))
    if mask is not None:
        strength[mask == 0] = 0.0
    height, width = image.shape
    side = max(8, int(np.sqrt(height * width / wanted)))
    best = _strongest(strength, side, border)
    distance = 0.6 * side
    by_row = np.ascontiguousarray(occupied[np.argsort(occupied[:, 1])])
    best = best[_far(best, by_row, np.searchsorted(by_row[:, 1], best[:, 1] - distance), distance)]
    if not len(best):
        return np.zeros((0, 2))
    # the strongest corner of a cell without texture is noise: a small share of the median strength is required
    floor = 0.04 * np.median(best[:, 2])
    best = best[best[:, 2] > floor]
    return np.ascontiguousarray(best[np.argsort(-best[:, 2], kind="stable"), :2])


def load_mask(path: str, rig: StereoRig) -> NDArray[np.uint8] | None:
    """Read a mask image `(H, W)` of a rig, None for an empty path; corners stay a patch's width from where it is 0.

    Raises ConfigError if it cannot be read or has another size.
    """
    if not path:
        return None
    mask = read_mask(path)
    if mask.shape != (rig.height, rig.width):
        found = f"{mask.shape[1]} x {mask.shape[0]} pixels"
        raise ConfigError(f"mask '{path}': {found}; give a grey image of {rig.width} x {rig.height} pixels")
    return np.asarray(cv2.erode(mask, np.ones((2 * BLOCK + 1, 2 * BLOCK + 1), np.uint8)), dtype=np.uint8)


def read_mask(path: str) -> NDArray[np.uint8]:
    """Read the image `(H, W)` of a mask, of whatever size; raises ConfigError if it cannot be read."""
    try:
        data = read_bytes(Path(path), MAX_MASK_BYTES)
        head = _PNG_HEAD.match(data)
        if head is None:
            raise ConfigError(f"mask '{path}': no PNG; give a grey PNG of the size of the images")
        check_image_size(int.from_bytes(head[1], "big"), int.from_bytes(head[2], "big"))
        mask = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
    except (OSError, GeometryError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ConfigError(f"mask '{path}': {reason}; give a grey PNG of the size of the images") from error
    if mask is None:
        raise ConfigError(f"mask '{path}': broken; give a grey PNG of the size of the images")
    return np.asarray(mask, dtype=np.uint8)


@jit_fast
def _fill_strength(image: FloatImage, strength: FloatImage, first: int, end: int) -> None:
    """Fill rows of the strength: gradients by Sobel's filter, their products summed over the block."""
    height, width = image.shape
    reach = BLOCK // 2
    products = np.zeros((3, BLOCK, width), np.float32)  # xx, xy, yy of the last rows, one after the other
    sums = np.empty((3, width), np.float32)
    across = np.empty((3, width), np.float32)
    two, half = np.float32(2.0), np.float32(0.5)
    for row in range(max(first - reach, 1), min(end + reach, height - 1)):
        xx, xy, yy = products[0, row % BLOCK], products[1, row % BLOCK], products[2, row % BLOCK]
        above, here, below = image[row - 1], image[row], image[row + 1]
        for x in range(1, width - 1):
            dx = above[x + 1] - above[x - 1] + two * (here[x + 1] - here[x - 1]) + below[x + 1] - below[x - 1]
            dy = below[x - 1] - above[x - 1] + two * (below[x] - above[x]) + below[x + 1] - above[x + 1]
            xx[x], xy[x], yy[x] = dx * dx, dx * dy, dy * dy
        centre = row - reach
        if centre < max(first, 1 + reach):
            continue
        for c in range(3):
            copy_row(products[c, 0], sums[c])
            for k in range(1, BLOCK):
                for x in range(width):
                    sums[c, x] += products[c, k, x]
            across[c] = 0.0
            for k in range(-reach, reach + 1):
                for x in range(reach, width - reach):
                    across[c, x] += sums[c, x + k]
        out = strength[centre]
        for x in range(reach + 1, width - reach - 1):
            mean, split = half * (across[0, x] + across[2, x]), half * (across[0, x] - across[2, x])
            out[x] = mean - np.sqrt(split * split + across[1, x] * across[1, x])


@jit
def _strongest(strength: FloatImage, side: int, border: int) -> FloatArray:
    height, width = strength.shape
    rows, columns = -(-height // side), -(-width // side)
    best = np.zeros((rows * columns, 3))
    for row in range(rows):
        for column in range(columns):
            cell = row * columns + column
            for y in range(max(border, row * side), min(height - border, row * side + side)):
                for x in range(max(border, column * side), min(width - border, column * side + side)):
                    if strength[y, x] > best[cell, 2]:
                        best[cell, 0], best[cell, 1], best[cell, 2] = x, y, strength[y, x]
    return best[best[:, 2] > 0.0]


@jit
def _far(found: FloatArray, by_row: FloatArray, first: NDArray[np.intp], distance: float) -> NDArray[np.bool_]:
    """Tell which of found points `(N, 3)` are at least so far from occupied ones `(M, 2)`, in the order of their rows.

    Those before `first` `(N,)` are too far above.
    """
    far = np.ones(len(found), np.bool_)
    for n in range(len(found)):
        for m in range(first[n], len(by_row)):
            du, dv = found[n, 0] - by_row[m, 0], found[n, 1] - by_row[m, 1]
            if dv <= -distance:
                break
            if du * du + dv * dv < distance * distance:
                far[n] = False
                break
    return far
