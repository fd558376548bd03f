"""What each cell of the left image shows, whatever pose is found: as before, or something that has moved.

A cell is compared with itself in an earlier image. What is left of the difference without a change of brightness and
contrast is the noise of each pixel, or has structure: neighbours differ alike. Structure tells that something moved, by
a third of a pixel or more. Texture without such structure is where it was. Two things are told so of a pose: cells that
stay though it moves them are fixed to the camera, and cells that change though it does not move them contradict it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage, Mask
from sfr_loc_map.geometry.camera import Pose, StereoCamera
from sfr_loc_map.geometry.small_linalg import reorder_to_rank
from sfr_loc_map.jit import jit_fast, jit_fast_inline
from sfr_loc_map.localisation.frontend.landmarks import BORDER, MIN_INVERSE_DEPTH
from sfr_loc_map.localisation.frontend.pose_solver import LandmarkEstimates

LEVEL: Final = 1  #: Pyramid level that is compared: noise is half of that of the image, the ground's texture is not.
SIDE: Final = 8  #: Pixels of that level along a cell.
CELL: Final = SIDE << LEVEL  #: Pixels of the image along a cell.
NOISE_CORRELATION: Final = 0.35  #: Correlation of neighbouring pixels, of that level, beyond which it is no noise.
MIN_CHANGE: Final = 0.03
"""Smallest part of the variance of the steps between neighbours, along which it is least, that counts as moved: that of
a third of a pixel."""
MAX_NOISE: Final = 0.33  #: Largest part of it that a difference may have where texture is said to stay.
MIN_STEP: Final = 1.0  #: Smallest variance of such steps, grey levels squared, that is texture.
CONTRAST: Final = 4.0  #: Variance, grey levels squared, below which a cell tells nothing of a change of contrast.
FIXED_LIFE, MOVING_LIFE = 10, 8
"""Pairs for which a cell is left out after it was last seen to be fixed, or to move."""
NEAR: Final = 4  #: Cells to each side within which landmarks tell how the image moves.
STILL_PX, MOVED_PX = 0.25, 2.0
"""Image motion up to which a pose leaves a cell where it was, and from which on it moves it."""
MOST_PX: Final = 10.0  #: Longer motions of landmarks count as so long.


class Change(NamedTuple):
    """What a left image shows against an earlier one, by cell `(R, C)`."""

    changed: Mask  #: Something has moved.
    stays: Mask  #: Texture is where it was.


@jit_fast
def change_of(before: FloatImage, now: FloatImage) -> Change:
    """Compare the cells of two images of the level."""
    rows, columns = now.shape[0] // SIDE, now.shape[1] // SIDE
    changed, stays = np.zeros((rows, columns), np.bool_), np.zeros((rows, columns), np.bool_)
    rest, count, pairs = np.empty((SIDE, SIDE), np.float32), np.float32(SIDE * SIDE), np.float32((SIDE - 1) ** 2)
    for row in range(rows):
        for column in range(columns):
            old = before[SIDE * row : SIDE * row + SIDE, SIDE * column : SIDE * column + SIDE]
            new = now[SIDE * row : SIDE * row + SIDE, SIDE * column : SIDE * column + SIDE]
            of_old = of_new = square = product = np.float32(0.0)
            for j in range(SIDE):
                for i in range(SIDE):
                    of_old += old[j, i]
                    of_new += new[j, i]
                    square += old[j, i] * old[j, i]
                    product += old[j, i] * new[j, i]
            of_old, of_new = of_old / count, of_new / count
            spread = square / count - of_old * of_old
            gain = (product / count - of_old * of_new + np.float32(CONTRAST)) / (spread + np.float32(CONTRAST))
            variance = np.float32(0.0)
            for j in range(SIDE):
                for i in range(SIDE):
                    rest[j, i] = new[j, i] - of_new - gain * (old[j, i] - of_old)
                    variance += rest[j, i] * rest[j, i]
            alike_u = alike_v = along_uu = along_uv = along_vv = mean_u = mean_v = np.float32(0.0)
            for j in range(SIDE - 1):
                for i in range(SIDE - 1):
                    alike_u += rest[j, i] * rest[j, i + 1]
                    alike_v += rest[j, i] * rest[j + 1, i]
                    u, v = new[j, i + 1] - new[j, i], new[j + 1, i] - new[j, i]
                    mean_u, mean_v = mean_u + u, mean_v + v
                    along_uu, along_uv, along_vv = along_uu + u * u, along_uv + u * v, along_vv + v * v
            # an even slope that moves is a change of brightness, an edge may move along itself
            mean_u, mean_v = mean_u / pairs, mean_v / pairs
            uu, uv, vv = along_uu / pairs - mean_u**2, along_uv / pairs - mean_u * mean_v, along_vv / pairs - mean_v**2
            step = 0.5 * (uu + vv) - np.sqrt(0.25 * (uu - vv) ** 2 + uv * uv)
            variance, structure = variance / count, max(alike_u, alike_v) / pairs
            changed[row, column] = structure > NOISE_CORRELATION * variance and structure > MIN_CHANGE * step
            stays[row, column] = not changed[row, column] and step > MIN_STEP + variance / MAX_NOISE
    return Change(changed, stays)


class Judged(NamedTuple):
    """What a motion explains of a pair, by its M landmarks and the cells `(R, C)`."""

    far: float  #: 90th percentile of how far it moves them in the image, pixels; 0 without any.
    cell: NDArray[np.intp]  #: `(M,)` numbers of the cells where it sees them, R * C outside.
    stays: Mask  #: `(M,)` landmarks that were made on cells that stay.
    fixed: Mask  #: `(M,)` those of them that it would move and does not explain: they are fixed to the camera.
    rest: Mask  #: `(M,)` landmarks in view that do not agree, without what is fixed and what that covers.
    share: float  #: Share of them among those in view.
    cells: Mask  #: `(R, C)` the cells that stay though it moves them.
    wrong: float  #: Share of the cells that changed though it leaves them where they were.


@jit_fast_inline
def _cell_of(u: float, v: float, rows: int, columns: int) -> int:
    if not (0.0 <= u < CELL * columns and 0.0 <= v < CELL * rows):  # also NaN
        return rows * columns
    return int(v) // CELL * columns + int(u) // CELL


@jit_fast_inline
def _is_set(cells: Mask, cell: int) -> bool:
    return cell < cells.size and bool(cells[cell // cells.shape[1], cell % cells.shape[1]])


@jit_fast_inline
def _around(values: FloatArray, r: int, c: int, reach: int) -> tuple[float, float]:
    """Return the sum and the least of the values around one; with numba's own each start would load scipy.linalg."""
    total, least = 0.0, np.inf
    for i in range(max(r - reach, 0), min(r + reach + 1, values.shape[0])):
        for j in range(max(c - reach, 0), min(c + reach + 1, values.shape[1])):
            total += values[i, j]
            least = min(least, values[i, j])
    return total, least


@jit_fast
def judge(
    pose: Pose,
    still: Pose,
    landmarks: LandmarkEstimates,
    host_uv: FloatArray,
    inliers: Mask,
    change: Change,
    camera: StereoCamera,
    shape: tuple[int, int],
    far_px: float,
) -> Judged:
    """Judge a motion from one pose to another by the landmarks and cells of an image `(height, width)`.

    Landmarks at infinity are taken as far away. One moved by more than `far_px` and not found contradicts nothing.
    """
    hosts, rays, inverse_depth, _ = landmarks
    count, (rows, columns), (height, width) = len(inverse_depth), change.changed.shape, shape
    length, cell, stays = np.full(count, np.nan), np.zeros(count, np.intp), np.zeros(count, np.bool_)
    fixed, rest, in_view = stays.copy(), stays.copy(), 0
    sums, counts, seen = np.zeros((rows, columns)), np.zeros((rows, columns)), np.empty((2, 2))
    least = np.full((rows, columns), MOST_PX)
    for n in range(count):
        rho = max(inverse_depth[n], MIN_INVERSE_DEPTH)
        for k in range(2):
            target = pose if k == 0 else still
            x = y = z = 0.0
            for i in range(3):
                along = rho * (hosts.positions[n, i] - target.position[i])
                for j in range(3):
                    along += hosts.rotations[n, i, j] * rays[n, j]
                x += along * target.rotation[i, 0]
                y += along * target.rotation[i, 1]
                z += along * target.rotation[i, 2]
            z = z if z > 1e-6 else np.nan
            seen[k, 0], seen[k, 1] = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
        u, v = seen[0, 0], seen[0, 1]
        length[n], cell[n] = np.hypot(u - seen[1, 0], v - seen[1, 1]), _cell_of(u, v, rows, columns)
        host = _cell_of(host_uv[n, 0], host_uv[n, 1], rows, columns)
        stays[n] = _is_set(change.stays, host)
        tells = inliers[n] or length[n] < far_px
        if tells and BORDER < u < width - 1 - BORDER and BORDER < v < height - 1 - BORDER:
            rest[n] = not inliers[n]
            in_view += 1
            if cell[n] < rows * columns:
                r, c = cell[n] // columns, cell[n] % columns
                sums[r, c] += min(length[n], MOST_PX)
                counts[r, c] += 1.0
                least[r, c] = min(length[n], least[r, c])
    cells, wrong = np.zeros((rows, columns), np.bool_), 0
    for r in range(rows):
        for c in range(columns):
            if change.stays[r, c] or change.changed[r, c]:
                near = _around(counts, r, c, NEAR)[0]
                # beside the point from which all moves away the motion differs from cell to cell
                moves = _around(counts, r, c, 1)[0] > 0.0 and _around(least, r, c, 1)[1] > MOVED_PX
                cells[r, c] = change.stays[r, c] and moves
                wrong += change.changed[r, c] and _around(sums, r, c, NEAR)[0] < STILL_PX * near
    left, known, lengths = 0, 0, np.empty(count)
    for n in range(count):
        host = _cell_of(host_uv[n, 0], host_uv[n, 1], rows, columns)
        fixed[n] = _is_set(cells, host) and not inliers[n]
        rest[n] = rest[n] and not (fixed[n] or _is_set(cells, cell[n]))
        left += rest[n]
        if not np.isnan(length[n]):
            lengths[known] = length[n]
            known += 1
    return Judged(
        reorder_to_rank(lengths[:known], 9 * known // 10) if known else 0.0,
        cell,
        stays,
        fixed,
        rest,
        left / max(in_view, 1),
        cells,
        wrong / max(rows * columns, 1),
    )


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

    def with_cells(self, fixed: Mask, moving: Mask) -> ExcludedCells:
        """Exclude cells `(R, C)`, fixed to the camera or moving, from the next pair on."""
        life = self.life.copy()
        is_fixed = self.is_fixed.copy()
        life[moving] = MOVING_LIFE
        life[fixed] = FIXED_LIFE
        is_fixed[moving] = False
        is_fixed[fixed] = True
        return replace(self, life=life, is_fixed=is_fixed)

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


def cell_counts(shape: tuple[int, int]) -> tuple[int, int]:
    """Return the numbers of rows and columns of cells in an image of a shape (height, width)."""
    height, width = shape
    return height // 2 // SIDE, width // 2 // SIDE
