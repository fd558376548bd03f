"""Cells of the left image that are excluded for a while, because they do not move with the ground."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import Mask
from sfr_loc_map.localisation.frontend.cell_change import CELL, cell_counts

FIXED_LIFE: Final = 10
"""Pairs for which a cell is excluded after it was last seen to be fixed to the camera. It is the number after which the
compared image is replaced (`ground_motion.COMPARED_PAIRS`), so that each cell is seen again before."""
MOVING_LIFE: Final = 8
"""Pairs for which a cell is excluded after it was last seen to move. An object leaves its cells within some pairs."""


@dataclass(frozen=True, slots=True, eq=False)
class ExcludedCells:
    """Cells `(R, C)` of the left image that are excluded because they do not move with the ground."""

    life: NDArray[np.int64]  #: `(R, C)` number of pairs for which a cell is still excluded.
    is_fixed: Mask  #: `(R, C)` whether a cell was excluded because it is fixed to the camera.
    mask: NDArray[np.uint8] | None = None  #: `(H, W)`, 0 where no landmark is created; None if nothing is excluded.
    fraction: float = 0.0  #: Fraction of the image that is excluded.
    moving_fraction: float = 0.0  #: Fraction of the cells that are excluded because they move.

    @classmethod
    def none(cls, shape: tuple[int, int]) -> ExcludedCells:
        """Return no excluded cells of an image of a shape (height, width)."""
        count = cell_counts(shape)
        return cls(np.zeros(count, np.int64), np.zeros(count, np.bool_))

    def with_fixed(self, cells: Mask) -> ExcludedCells:
        """Exclude cells `(R, C)` that are fixed to the camera, from the next pair on."""
        life = np.where(cells, FIXED_LIFE, self.life)
        return replace(self, life=life, is_fixed=self.is_fixed | cells)

    def with_moving(self, cells: Mask) -> ExcludedCells:
        """Exclude cells `(R, C)` that move otherwise than the ground, from the next pair on."""
        life = np.where(cells, MOVING_LIFE, self.life)
        return replace(self, life=life, is_fixed=self.is_fixed & ~cells)

    def after_selection(
        self, fixed: Mask | None, moving: Mask | None, stays: Mask, shape: tuple[int, int], *, has_excluded: bool
    ) -> ExcludedCells:
        """Return the excluded cells after a pair.

        Args:
            fixed: `(R, C)` cells that are fixed to the camera; None if unknown.
            moving: `(R, C)` cells that move otherwise than the ground; None if unknown.
            stays: `(R, C)` cells whose texture stays.
            shape: Height and width of the image.
            has_excluded: Whether landmarks of the pair were excluded.
        """
        excluded = self
        if fixed is not None and fixed.any():
            excluded = excluded.with_fixed(fixed)
        if moving is not None:
            excluded = excluded.with_moving(moving)
        if excluded.mask is None and not has_excluded:
            return excluded
        return excluded.after_pair(stays, shape)

    def after_pair(self, stays: Mask, shape: tuple[int, int]) -> ExcludedCells:
        """Age the cells by a pair, in which the texture of some cells `(R, C)` stays, and draw the mask.

        The mask also covers the neighbours of an excluded cell. The shape of the image is (height, width).
        """
        life = np.maximum(self.life - 1, 0)
        life[self.is_fixed & stays & (life > 0)] = FIXED_LIFE
        moving_fraction = float(np.mean((life > 0) & ~self.is_fixed))
        if not life.any():
            return ExcludedCells(life, self.is_fixed, moving_fraction=moving_fraction)
        free = cv2.erode((life == 0).astype(np.uint8), np.ones((3, 3), np.uint8))
        mask = np.repeat(np.repeat(free * np.uint8(255), CELL, axis=0), CELL, axis=1)
        borders = [(0, size - drawn) for size, drawn in zip(shape, mask.shape, strict=True)]
        mask = np.pad(mask, borders, mode="edge")
        return ExcludedCells(life, self.is_fixed, mask, float(np.mean(free == 0)), moving_fraction)
