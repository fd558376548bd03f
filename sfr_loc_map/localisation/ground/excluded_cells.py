"""Cells of the left image that are excluded for several pairs because they do not move with the ground.

A cell is excluded because it is fixed to the camera, or because it is dynamic (it moves differently from the ground).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import Mask
from sfr_loc_map.localisation.ground.cell_change import CELL, cell_counts

FIXED_LIFE: Final = 10
"""Lifetime, pairs, of a cell that was detected as fixed to the camera. Each pair, including the pair of the detection,
reduces the lifetime by one. If the cell is stationary, its lifetime starts again instead. Chosen by hand. If larger,
ground that an arm has uncovered has no landmarks for longer. If smaller, landmarks are created on a body whose
illumination changes."""
DYNAMIC_LIFE: Final = 8
"""Lifetime, pairs, of a cell that was detected as dynamic. Each pair, including the pair of the detection, reduces the
lifetime by one, so that the cell is excluded in seven pairs. Chosen by hand: an object leaves its cells within a few
pairs. If larger, the ground behind the object has no new landmarks for longer. If smaller, landmarks are created on the
object."""


@dataclass(frozen=True, slots=True, eq=False)
class ExcludedCells:
    """Cells `(R, C)` of the left image that are excluded because they do not move with the ground."""

    life: NDArray[np.int64]  #: `(R, C)` number of pairs for which a cell remains excluded.
    is_fixed: Mask  #: `(R, C)` whether a cell was excluded because it is fixed to the camera.
    #: `(H, W)`, 0 where landmarks are not created. None before a pair with excluded landmarks (`after_selection`), and
    #: if no cell has lifetime left.
    mask: NDArray[np.uint8] | None = None
    fraction: float = 0.0  #: Fraction of the image that is excluded.
    dynamic_fraction: float = 0.0  #: Fraction of the cells that are excluded because they are dynamic.

    @classmethod
    def none(cls, shape: tuple[int, int]) -> ExcludedCells:
        """Return an instance without excluded cells, for images of a shape (height, width)."""
        count = cell_counts(shape)
        return cls(np.zeros(count, np.int64), np.zeros(count, np.bool_))

    def with_fixed(self, cells: Mask) -> ExcludedCells:
        """Start the lifetime of cells `(R, C)` that are fixed to the camera."""
        life = np.where(cells, FIXED_LIFE, self.life)
        return replace(self, life=life, is_fixed=self.is_fixed | cells)

    def with_dynamic(self, cells: Mask) -> ExcludedCells:
        """Start the lifetime of cells `(R, C)` that move differently from the ground."""
        life = np.where(cells, DYNAMIC_LIFE, self.life)
        return replace(self, life=life, is_fixed=self.is_fixed & ~cells)

    def after_selection(
        self, fixed: Mask | None, dynamic: Mask | None, stationary: Mask, shape: tuple[int, int], *, has_excluded: bool
    ) -> ExcludedCells:
        """Return the excluded cells after a pair, including the cells that the pair excludes.

        The returned mask also applies to a keyframe that this pair becomes.

        Args:
            fixed: `(R, C)` cells that are fixed to the camera; None if unknown.
            dynamic: `(R, C)` cells that move differently from the ground; None if unknown.
            stationary: `(R, C)` stationary cells.
            shape: Height and width of the image.
            has_excluded: Whether landmarks of the pair were excluded. Masking starts with such a pair and continues
                while any cell has lifetime left. A cell without landmarks may look fixed by chance (sky, horizon), and
                masks of such cells alone would change two of three drives without a fault.
        """
        is_masked = self.mask is not None or has_excluded
        excluded = self
        if fixed is not None and fixed.any():
            excluded = excluded.with_fixed(fixed)
        if dynamic is not None:
            excluded = excluded.with_dynamic(dynamic)
        excluded = excluded.aged(stationary)
        return excluded.with_mask(shape) if is_masked else excluded

    def aged(self, stationary: Mask) -> ExcludedCells:
        """Return the cells after another pair, without a mask. `stationary` `(R, C)` marks stationary cells."""
        life = np.maximum(self.life - 1, 0)
        life[self.is_fixed & stationary & (life > 0)] = FIXED_LIFE
        dynamic_fraction = float(np.mean((life > 0) & ~self.is_fixed))
        return ExcludedCells(life, self.is_fixed, dynamic_fraction=dynamic_fraction)

    def with_mask(self, shape: tuple[int, int]) -> ExcludedCells:
        """Return the cells with a mask that covers them and their neighbours; the shape is (height, width)."""
        if not self.life.any():
            return self
        free = cv2.erode((self.life == 0).astype(np.uint8), np.ones((3, 3), np.uint8))
        mask = np.repeat(np.repeat(free * np.uint8(255), CELL, axis=0), CELL, axis=1)
        borders = [(0, size - drawn) for size, drawn in zip(shape, mask.shape, strict=True)]
        mask = np.pad(mask, borders, mode="edge")
        return replace(self, mask=mask, fraction=float(np.mean(free == 0)))
