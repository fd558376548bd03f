"""Change detection: which cells of the left image have moved since an earlier image, independently of the pose.

A cell is compared with the same cell of an earlier image. Brightness and contrast are fitted first. The residual is
either noise, which is independent from pixel to pixel, or correlated between neighbours. Correlated residuals show that
the content of the cell has moved by a third of a pixel or more. A textured cell without them has not moved.

A pose is checked by both. Cells that do not move although the pose predicts image motion are fixed to the camera. Cells
that change although the pose predicts none contradict the pose.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage, Mask
from sfr_loc_map.geometry.camera import Pose, StereoCamera
from sfr_loc_map.jit import jit_fast, jit_fast_inline, jit_fast_ir_inline
from sfr_loc_map.localisation.frontend.landmarks import BORDER, MIN_INVERSE_DEPTH
from sfr_loc_map.localisation.frontend.pose_solver import LandmarkEstimates
from sfr_loc_map.localisation.frontend.projection import (
    MIN_SCALED_DEPTH,
    component,
    difference,
    rotated_ray,
    scaled_point,
)
from sfr_loc_map.localisation.small_linalg import reorder_to_rank

# Values without a stated reason were chosen by hand. Recorded trials of others: measurements/localiser_trials.md.
LEVEL: Final = 1  #: Pyramid level that is compared: it has half the noise of the image but most of its texture.
SIDE: Final = 8  #: Side of a cell, pixels of that level.
CELL: Final = SIDE << LEVEL  #: Side of a cell, pixels of the image.
NOISE_CORRELATION: Final = 0.35  #: Correlation of neighbouring pixels of the residual above which it is not noise.
MIN_CHANGE: Final = 0.03
"""Threshold of change: covariance of neighbouring residuals over the smaller gradient variance. Content that moves by a
third of a pixel exceeds it."""
MAX_NOISE: Final = 0.33  #: Maximum variance of the residual of a cell that stays, over its smaller gradient variance.
MIN_GRADIENT: Final = 1.0  #: Minimum gradient variance of a textured cell, grey levels squared per pixel squared.
CONTRAST: Final = 4.0  #: Variance of a cell, grey levels squared, at which the gain is halfway between 1 and its fit.
FIXED_LIFE: Final = 10  #: Pairs for which a cell is excluded after it was last seen to be fixed to the camera.
MOVING_LIFE: Final = 8  #: Pairs for which a cell is excluded after it was last seen to move.
NEAR: Final = 4  #: Cells to each side whose landmarks predict the image motion of a cell.
STATIONARY_PX, MOVED_PX = 0.25, 2.0
"""Image motion, pixels, below which a pose leaves a cell where it was, and above which the pose moves the cell."""
MAX_MOTION_PX: Final = 10.0  #: Image motion, pixels, at which that of a landmark is clipped.


class Change(NamedTuple):
    """Left image against an earlier one, by cell `(R, C)`."""

    changed: Mask  #: The content has moved.
    stays: Mask  #: The cell is textured and its content has not moved.


@jit_fast_ir_inline
def _fill_residual(before: FloatImage, now: FloatImage, residual: FloatImage) -> np.float32:
    """Fill what a change of brightness and contrast leaves of the difference of two cells; return its variance."""
    count = np.float32(SIDE * SIDE)
    sum_before = sum_now = sum_squares = sum_products = np.float32(0.0)
    for j in range(SIDE):
        for i in range(SIDE):
            sum_before += before[j, i]
            sum_now += now[j, i]
            sum_squares += before[j, i] * before[j, i]
            sum_products += before[j, i] * now[j, i]
    mean_before = sum_before / count
    mean_now = sum_now / count
    variance_before = sum_squares / count - mean_before * mean_before
    covariance = sum_products / count - mean_before * mean_now
    gain = (covariance + np.float32(CONTRAST)) / (variance_before + np.float32(CONTRAST))
    sum_residuals = np.float32(0.0)
    for j in range(SIDE):
        for i in range(SIDE):
            residual[j, i] = now[j, i] - mean_now - gain * (before[j, i] - mean_before)
            sum_residuals += residual[j, i] * residual[j, i]
    return sum_residuals / count


@jit_fast_ir_inline
def _neighbour_covariance(residual: FloatImage) -> np.float32:
    """Return the covariance of neighbouring pixels of a residual, the larger one of along rows and along columns."""
    along_u = along_v = np.float32(0.0)
    for j in range(SIDE - 1):
        for i in range(SIDE - 1):
            along_u += residual[j, i] * residual[j, i + 1]
            along_v += residual[j, i] * residual[j + 1, i]
    covariance: np.float32 = max(along_u, along_v) / np.float32((SIDE - 1) ** 2)
    return covariance


@jit_fast_ir_inline
def _gradient_variance(cell: FloatImage) -> np.float32:
    """Return the smaller eigenvalue of the covariance of the gradients of a cell (compare Shi and Tomasi 1994).

    The mean gradient is subtracted because a constant slope that moves is a change of brightness. The smaller
    eigenvalue counts because an edge may move along itself.
    """
    count = np.float32((SIDE - 1) ** 2)
    sum_uu = sum_uv = sum_vv = sum_u = sum_v = np.float32(0.0)
    for j in range(SIDE - 1):
        for i in range(SIDE - 1):
            du = cell[j, i + 1] - cell[j, i]
            dv = cell[j + 1, i] - cell[j, i]
            sum_u += du
            sum_v += dv
            sum_uu += du * du
            sum_uv += du * dv
            sum_vv += dv * dv
    mean_u = sum_u / count
    mean_v = sum_v / count
    uu = sum_uu / count - mean_u**2
    uv = sum_uv / count - mean_u * mean_v
    vv = sum_vv / count - mean_v**2
    smaller: np.float32 = 0.5 * (uu + vv) - np.sqrt(0.25 * (uu - vv) ** 2 + uv * uv)
    return smaller


@jit_fast
def change_of(before: FloatImage, now: FloatImage) -> Change:
    """Compare the cells of two images of the level."""
    rows = now.shape[0] // SIDE
    columns = now.shape[1] // SIDE
    changed = np.zeros((rows, columns), np.bool_)
    stays = np.zeros((rows, columns), np.bool_)
    residual = np.empty((SIDE, SIDE), np.float32)
    for row in range(rows):
        for column in range(columns):
            cell_before = before[SIDE * row : SIDE * row + SIDE, SIDE * column : SIDE * column + SIDE]
            cell_now = now[SIDE * row : SIDE * row + SIDE, SIDE * column : SIDE * column + SIDE]
            noise = _fill_residual(cell_before, cell_now, residual)
            structure = _neighbour_covariance(residual)
            texture = _gradient_variance(cell_now)
            changed[row, column] = structure > NOISE_CORRELATION * noise and structure > MIN_CHANGE * texture
            stays[row, column] = not changed[row, column] and texture > MIN_GRADIENT + noise / MAX_NOISE
    return Change(changed, stays)


class Explained(NamedTuple):
    """How far a motion explains a pair, by M landmarks and the cells `(R, C)`."""

    motion_px: float  #: 90th percentile of the image motion of the landmarks, pixels; 0 without landmarks.
    cell_index: NDArray[np.intp]  #: `(M,)` numbers of the cells in which the pose sees the landmarks; R * C outside.
    on_static: Mask  #: `(M,)` landmarks whose host pixels are in cells that stay.
    on_fixed: Mask  #: `(M,)` outliers among these that the pose moves: they are fixed to the camera.
    unexplained: Mask  #: `(M,)` outliers in view that neither are fixed to the camera nor lie in a cell that is.
    unexplained_fraction: float  #: Fraction of `unexplained` among the landmarks in view.
    fixed_cells: Mask  #: `(R, C)` cells that stay although the pose moves them.
    contradicting_fraction: float  #: Fraction of the cells that changed although the pose does not move them.


@jit_fast_inline
def _cell_of(u: float, v: float, rows: int, columns: int) -> int:
    """Return the number of the cell of a pixel; rows * columns outside, and for NaN."""
    if not (0.0 <= u < CELL * columns and 0.0 <= v < CELL * rows):
        return rows * columns
    return int(v) // CELL * columns + int(u) // CELL


@jit_fast_inline
def _is_set(cells: Mask, cell: int) -> bool:
    """Tell whether a cell of a number is set; False outside."""
    return cell < cells.size and bool(cells[cell // cells.shape[1], cell % cells.shape[1]])


class _Neighbourhood(NamedTuple):
    """Values around a cell."""

    total: float
    smallest: float


@jit_fast_inline
def _around(values: FloatArray, row: int, column: int, reach: int) -> _Neighbourhood:
    """Return the sum and the minimum of the values up to some cells away; numba's own would load scipy.linalg."""
    total = 0.0
    smallest = np.inf
    for i in range(max(row - reach, 0), min(row + reach + 1, values.shape[0])):
        for j in range(max(column - reach, 0), min(column + reach + 1, values.shape[1])):
            total += values[i, j]
            smallest = min(smallest, values[i, j])
    return _Neighbourhood(total, smallest)


class _Pixel(NamedTuple):
    """Projection of a landmark into the left image, pixels; NaN behind the camera."""

    u: float
    v: float


@jit_fast_ir_inline
def _project(pose: Pose, landmarks: LandmarkEstimates, n: int, camera: StereoCamera) -> _Pixel:
    """Project a landmark. At infinity the smallest inverse depth is taken."""
    inverse_depth = max(landmarks.inverse_depth[n], MIN_INVERSE_DEPTH)
    host_ray = rotated_ray(landmarks.hosts.rotations[n], landmarks.rays[n, 0], landmarks.rays[n, 1])
    host_offset = difference(landmarks.hosts.positions[n], pose.position)
    point = scaled_point(host_ray, host_offset, inverse_depth)
    depth = component(pose.rotation, 2, point)
    if depth <= MIN_SCALED_DEPTH:
        depth = np.nan
    u = camera.fx * component(pose.rotation, 0, point) / depth + camera.cx
    v = camera.fy * component(pose.rotation, 1, point) / depth + camera.cy
    return _Pixel(u, v)


@jit_fast
def explain(
    pose: Pose,
    reference: Pose,
    landmarks: LandmarkEstimates,
    host_uv: FloatArray,
    inliers: Mask,
    change: Change,
    camera: StereoCamera,
    shape: tuple[int, int],
    far_px: float,
) -> Explained:
    """Return what a pose explains of the landmarks and the cells of an image `(height, width)`.

    Args:
        pose: Pose of the left camera at the image.
        reference: Pose of the left camera at the earlier image of the change.
        landmarks: The M landmarks.
        host_uv: `(M, 2)` host pixels of their patches.
        inliers: `(M,)` landmarks that agree with the pose.
        change: Cells of the image against the earlier one.
        camera: The camera.
        shape: Height and width of the image.
        far_px: Image motion above which a landmark that was not found is no evidence against the pose, pixels.
    """
    count = len(landmarks.inverse_depth)
    rows, columns = change.changed.shape
    height, width = shape
    motion_px = np.full(count, np.nan)
    cell = np.zeros(count, np.intp)
    stays = np.zeros(count, np.bool_)
    is_outlier = np.zeros(count, np.bool_)
    in_view = 0
    motion_sum = np.zeros((rows, columns))
    landmark_count = np.zeros((rows, columns))
    smallest_motion = np.full((rows, columns), MAX_MOTION_PX)
    for n in range(count):
        now = _project(pose, landmarks, n, camera)
        before = _project(reference, landmarks, n, camera)
        motion_px[n] = np.hypot(now.u - before.u, now.v - before.v)
        cell[n] = _cell_of(now.u, now.v, rows, columns)
        stays[n] = _is_set(change.stays, _cell_of(host_uv[n, 0], host_uv[n, 1], rows, columns))
        is_evidence = inliers[n] or motion_px[n] < far_px
        is_inside = BORDER < now.u < width - 1 - BORDER and BORDER < now.v < height - 1 - BORDER
        if not (is_evidence and is_inside):
            continue
        is_outlier[n] = not inliers[n]
        in_view += 1
        if cell[n] < rows * columns:
            row = cell[n] // columns
            column = cell[n] % columns
            motion_sum[row, column] += min(motion_px[n], MAX_MOTION_PX)
            landmark_count[row, column] += 1.0
            smallest_motion[row, column] = min(motion_px[n], smallest_motion[row, column])
    fixed_cells = np.zeros((rows, columns), np.bool_)
    contradicting = 0
    for row in range(rows):
        for column in range(columns):
            if change.stays[row, column]:
                # Beside the focus of expansion the motion differs from cell to cell: all landmarks around must move.
                has_landmarks = _around(landmark_count, row, column, 1).total > 0.0
                fixed_cells[row, column] = (
                    has_landmarks and _around(smallest_motion, row, column, 1).smallest > MOVED_PX
                )
            if change.changed[row, column]:
                near = _around(landmark_count, row, column, NEAR).total
                contradicting += _around(motion_sum, row, column, NEAR).total < STATIONARY_PX * near
    fixed = np.zeros(count, np.bool_)
    rest = np.zeros(count, np.bool_)
    rest_count = 0
    known_px = np.empty(count)
    known = 0
    for n in range(count):
        host_cell = _cell_of(host_uv[n, 0], host_uv[n, 1], rows, columns)
        fixed[n] = _is_set(fixed_cells, host_cell) and not inliers[n]
        rest[n] = is_outlier[n] and not (fixed[n] or _is_set(fixed_cells, cell[n]))
        rest_count += rest[n]
        if not np.isnan(motion_px[n]):
            known_px[known] = motion_px[n]
            known += 1
    return Explained(
        reorder_to_rank(known_px[:known], 9 * known // 10) if known else 0.0,
        cell,
        stays,
        fixed,
        rest,
        rest_count / max(in_view, 1),
        fixed_cells,
        contradicting / max(rows * columns, 1),
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

    def with_fixed(self, cells: Mask) -> ExcludedCells:
        """Exclude cells `(R, C)` that are fixed to the camera, from the next pair on."""
        life = np.where(cells, FIXED_LIFE, self.life)
        return replace(self, life=life, is_fixed=self.is_fixed | cells)

    def with_moving(self, cells: Mask) -> ExcludedCells:
        """Exclude cells `(R, C)` that move otherwise than the ground, from the next pair on."""
        life = np.where(cells, MOVING_LIFE, self.life)
        return replace(self, life=life, is_fixed=self.is_fixed & ~cells)

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
