"""Cells of the left image that are excluded for several pairs because they do not move with the ground.

A cell is excluded because it is fixed to the camera, or because it is dynamic (it moves differently from the ground).
Lifetimes are counted in pairs that are compared with an earlier image and from which the memory learns. In other pairs,
a body that still covers its cells cannot renew their lifetime. A textured pair with too few landmarks for a new window
also counts, because the excluded cells may be the cause.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import Mask
from sfr_loc_map.localisation.ground.cell_change import CELL, cell_counts
from sfr_loc_map.localisation.ground.thresholds import DYNAMIC_LIFE, FIXED_LIFE


class Exclusion(NamedTuple):
    """Landmarks and cells that do not move with the ground, as a pair shows."""

    rows: NDArray[np.intp]  #: `(N,)` window rows of landmarks.
    fixed: Mask  #: `(R, C)` cells that are fixed to the camera.
    dynamic: Mask  #: `(R, C)` cells that move differently from the ground.

    @classmethod
    def of_fixed(cls, rows: NDArray[np.intp], cells: Mask) -> Exclusion:
        """Return the exclusion of landmarks and cells that are fixed to the camera."""
        return cls(rows, cells, np.zeros_like(cells))

    @classmethod
    def nothing(cls, shape: tuple[int, ...]) -> Exclusion:
        """Return the exclusion of nothing, for a shape (R, C) of the cells."""
        return cls.of_fixed(np.zeros(0, np.intp), np.zeros(shape, np.bool_))


@dataclass(frozen=True, slots=True, eq=False)
class ExcludedCells:
    """Cells `(R, C)` of the left image that are excluded because they do not move with the ground."""

    life: NDArray[np.int64]  #: `(R, C)` number of pairs for which a cell remains excluded.
    is_fixed: Mask  #: `(R, C)` whether a cell was excluded because it is fixed to the camera.
    #: `(H, W)`, 0 where landmarks are not created. None before a pair that excludes landmarks (`after_pair`), and if no
    #: cell has lifetime left.
    mask: NDArray[np.uint8] | None = None
    fraction: float = 0.0  #: Fraction of the image that is excluded.
    dynamic_fraction: float = 0.0  #: Fraction of the cells that are excluded because they are dynamic.

    @classmethod
    def none(cls, shape: tuple[int, int]) -> ExcludedCells:
        """Return an instance without excluded cells, for images of a shape (height, width)."""
        count = cell_counts(shape)
        return cls(np.zeros(count, np.int64), np.zeros(count, np.bool_))

    def after_pair(self, exclusion: Exclusion, stationary: Mask, shape: tuple[int, int]) -> ExcludedCells:
        """Return the excluded cells after a compared pair, including the cells that the pair excludes.

        The returned mask also applies to a keyframe that this pair becomes. Masking starts with a pair that excludes
        landmarks, and continues while any cell has lifetime left. A cell without landmarks may look fixed by chance
        (sky, horizon), and masks of such cells alone would change two of three drives without a fault.

        Args:
            exclusion: What the pair excludes.
            stationary: `(R, C)` stationary cells.
            shape: Height and width of the image.
        """
        is_fixed = (self.is_fixed | exclusion.fixed) & ~exclusion.dynamic
        life = np.where(exclusion.fixed, FIXED_LIFE, self.life)
        life = np.where(exclusion.dynamic, DYNAMIC_LIFE, life)
        life = np.maximum(life - 1, 0)
        life = np.where(is_fixed & stationary & (life > 0), FIXED_LIFE, life)
        dynamic_count = np.count_nonzero((life > 0) & ~is_fixed)
        excluded = ExcludedCells(life, is_fixed, dynamic_fraction=dynamic_count / max(life.size, 1))
        is_masked = self.mask is not None or len(exclusion.rows) > 0
        return excluded._with_mask(shape) if is_masked else excluded

    def older(self, shape: tuple[int, int]) -> ExcludedCells:
        """Return the excluded cells after a pair that renews no lifetime. The shape is (height, width)."""
        nothing = Exclusion.nothing(self.life.shape)
        return self.after_pair(nothing, nothing.fixed, shape)

    def _with_mask(self, shape: tuple[int, int]) -> ExcludedCells:
        """Return the cells with a mask that covers them and their neighbours; the shape is (height, width)."""
        if not self.life.any():
            return self
        free = cv2.erode((self.life == 0).astype(np.uint8), np.ones((3, 3), np.uint8))
        mask = np.repeat(np.repeat(free * np.uint8(255), CELL, axis=0), CELL, axis=1)
        borders = [(0, size - drawn) for size, drawn in zip(shape, mask.shape, strict=True)]
        mask = np.pad(mask, borders, mode="edge")
        return replace(self, mask=mask, fraction=float(np.mean(free == 0)))
