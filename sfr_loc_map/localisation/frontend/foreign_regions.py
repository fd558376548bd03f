"""Memory of image regions that do not move with the ground: own body, dirt, moving objects."""

from __future__ import annotations

from dataclasses import dataclass, fields

import cv2
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage, GreyImage, Mask
from sfr_loc_map.jit import jit_fast, jit_fast_ir_inline
from sfr_loc_map.localisation.frontend.patch import MIN_POWER, SIDE, Patch, half_width, normalise

MIN_FIXED_NCC = 0.8
"""Minimum normalised cross-correlation of a patch with the image where it was cut, if it is fixed to the camera."""
BESIDE_PX = 3
"""Distance at which such a patch must fit worse."""
MAX_AMBIGUITY = 0.5
"""Maximum ratio of its `1 - correlation` where it was cut to that beside."""
FIXED_LIFE, MOVING_LIFE = 10, 8
"""Pairs for which a region is left out after it was last seen to be fixed, or to move."""
MAX_MARKS = 4000
FLOW_WINDOW = (15, 15)
REACH = 1.25
"""Half side of the square around a mark, in spacings of landmarks."""


@jit_fast_ir_inline
def _correlation(image: FloatImage, template: Patch, power: np.float32, u: int, v: int, values: Patch) -> float:
    """Return the correlation of a template without mean with the image around a pixel; -1 outside, without texture."""
    height, width = image.shape
    half = half_width(template.size)
    if u < half or v < half or u + half >= width or v + half >= height:
        return -1.0
    k = 0
    for j in range(v - half, v + half + 1):
        for i in range(u - half, u + half + 1):
            values[k] = image[j, i]
            k += 1
    target = normalise(values)
    if target < MIN_POWER:
        return -1.0
    dot = np.float32(0.0)
    for k in range(values.size):
        dot += values[k] * template[k]
    return np.float64(dot / np.sqrt(power * target))


@jit_fast
def fixed_correlation(image: FloatImage, patches: Patch, uv: FloatArray) -> FloatArray:
    """Compare patches with an image at the pixels where they were cut and `BESIDE_PX` beside, in four directions.

    Args:
        image: `(H, W)` float32.
        patches: `(N, S * S)` float32.
        uv: `(N, 2)` whole pixels of their centres.

    Returns:
        `(N, 2)` normalised cross-correlation there, and the best one beside; -1 where the patch leaves the image or one
        of both has no texture, and beside where it does not fit where it was cut: most do not, and nothing follows.
    """
    values, template = np.empty(patches.shape[1], np.float32), np.empty(patches.shape[1], np.float32)
    out = np.full((len(uv), 2), -1.0)
    for n in range(len(uv)):
        u, v = int(uv[n, 0]), int(uv[n, 1])
        for k in range(template.size):
            template[k] = patches[n, k]
        power = normalise(template)
        if power < MIN_POWER:
            continue
        out[n, 0] = _correlation(image, template, power, u, v, values)
        if not out[n, 0] > MIN_FIXED_NCC:
            continue
        for direction in range(4):
            sign = BESIDE_PX if direction < 2 else -BESIDE_PX
            du, dv = (sign, 0) if direction % 2 == 0 else (0, sign)
            out[n, 1] = max(out[n, 1], _correlation(image, template, power, u + du, v + dv, values))
    return out


def stays(image: FloatImage, patches: Patch, uv: FloatArray) -> Mask:
    """Tell which patches `(N, S * S)` an image still shows at the pixels `(N, 2)` where they were cut, and only there.

    A patch that looks the same beside, as on a straight edge, says nothing.
    """
    here, beside = fixed_correlation(image, np.ascontiguousarray(patches), uv).T
    return np.asarray((here > MIN_FIXED_NCC) & (1.0 - here < MAX_AMBIGUITY * (1.0 - beside)))


@dataclass(frozen=True, slots=True, eq=False)
class Marks:
    """Points of foreign regions.

    Attributes:
        uv: `(K, 2)` where they are in the last left image, pixels.
        patches: `(K, S * S)` what is seen there, if fixed.
        fixed: `(K,)` whether they are fixed to the camera.
        life: `(K,)` pairs for which they still hold.
    """

    uv: FloatArray
    patches: Patch
    fixed: Mask
    life: NDArray[np.int64]

    def kept(self, which: Mask) -> Marks:
        """Return some of them."""
        return Marks(*(getattr(self, item.name)[which] for item in fields(self)))

    def with_more(self, other: Marks) -> Marks:
        """Return these before others."""
        if not len(other.uv):
            return self
        both = ((getattr(self, item.name), getattr(other, item.name)) for item in fields(self))
        return Marks(*map(np.concatenate, both))


class ForeignRegions:
    """Knows where the left image shows something that does not move with the ground.

    A region fixed to the camera holds for as long as its texture stays at its place, a moving one for a few pairs,
    carried on by optical flow.
    """

    def __init__(self, shape: tuple[int, int], max_features: int) -> None:
        """Start without regions; the shape is (height, width), landmarks are as dense as so many in an image."""
        self._shape = shape
        self._reach = round(REACH * max(8.0, np.sqrt(shape[0] * shape[1] / max_features)))
        self._marks = Marks(
            np.zeros((0, 2)), np.zeros((0, SIDE * SIDE), np.float32), np.zeros(0, np.bool_), np.zeros(0, np.int64)
        )
        self._mask: NDArray[np.uint8] | None = None
        self._image: GreyImage | None = None

    @property
    def mask(self) -> NDArray[np.uint8] | None:
        """Left image `(H, W)` uint8, 0 where no landmark shall be made; None without regions."""
        return self._mask

    @property
    def share(self) -> float:
        """Share of the left image that is left out."""
        return 0.0 if self._mask is None else float(np.count_nonzero(self._mask == 0) / self._mask.size)

    def add(self, uv: FloatArray, fixed: Mask, patches: Patch, which: Mask) -> None:
        """Add points that were found foreign in the last image.

        Args:
            uv: `(N, 2)` where they are, pixels.
            fixed: `(N,)` whether they are fixed to the camera.
            patches: `(N, S * S)` what is seen there, if fixed.
            which: `(N,)` those to be added.
        """
        life = np.where(fixed, FIXED_LIFE, MOVING_LIFE)
        self._marks = Marks(uv, patches, fixed, life).kept(which).with_more(self._marks)
        self._marks = self._marks.kept(np.arange(len(self._marks.uv)) < MAX_MARKS)
        self._draw()

    def update(self, image: GreyImage, smooth: FloatImage) -> None:
        """Go on to the next left image.

        Args:
            image: `(H, W)` uint8.
            smooth: `(H, W)` float32, level 0 of its pyramid.
        """
        before, self._image = self._image, image
        marks = self._marks
        if not len(marks.uv):
            return
        uv, life = marks.uv.copy(), marks.life - 1
        fixed, moving = np.flatnonzero(marks.fixed), np.flatnonzero(~marks.fixed)
        holds = fixed_correlation(smooth, marks.patches[fixed], uv[fixed])[:, 0] > MIN_FIXED_NCC
        life[fixed[holds]] = FIXED_LIFE
        if len(moving) and before is not None:
            uv[moving], found = _carried(before, image, uv[moving])
            life[moving[~found]] = 0
        self._marks = Marks(uv, marks.patches, marks.fixed, life).kept(life > 0)
        self._draw()

    def _draw(self) -> None:
        """Draw a square around each mark."""
        if not len(self._marks.uv):
            self._mask = None
            return
        height, width = self._shape
        free = np.full(self._shape, 255, np.uint8)
        column, row = np.rint(self._marks.uv).astype(int).T
        inside = (column >= 0) & (row >= 0) & (column < width) & (row < height)
        free[row[inside], column[inside]] = 0
        side = 2 * self._reach + 1
        self._mask = np.asarray(cv2.erode(free, np.ones((side, side), np.uint8)), np.uint8)


def _carried(before: GreyImage, image: GreyImage, uv: FloatArray) -> tuple[FloatArray, Mask]:
    """Return where points `(N, 2)` of the image before are now, by optical flow, and which were found."""
    start = uv.astype(np.float32)[:, None]
    moved, found, _ = cv2.calcOpticalFlowPyrLK(before, image, start, start.copy(), winSize=FLOW_WINDOW, maxLevel=3)
    return np.asarray(moved[:, 0], np.float64), np.asarray(found[:, 0] > 0)
