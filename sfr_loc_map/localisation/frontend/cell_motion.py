"""What a pose explains of the cells of the left image that changed, or stayed, since an earlier image (`cell_change`).

Cells that do not move although the pose predicts image motion are fixed to the camera. Cells that change although the
pose predicts none contradict the pose. Outliers in view that are not fixed to the camera are unexplained.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, Mask
from sfr_loc_map.geometry.camera import Pose, StereoCamera
from sfr_loc_map.jit import jit_fast, jit_fast_inline, jit_fast_ir_inline
from sfr_loc_map.localisation.frontend.cell_change import CELL, Change
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

NEAR: Final = 4
"""Cells to each side whose landmarks predict the image motion of a cell: 144 px, in which a hundred landmarks are
expected at 512 x 512."""
STATIONARY_PX: Final = 0.25
"""Image motion, px, below which a pose leaves a cell where it was: less than what shows as a change."""
MOVED_PX: Final = 2.0  #: Image motion, px, above which a pose moves a cell: six times what shows as a change.
MOTION_QUANTILE: Final = 0.9  #: Quantile of the image motion that is the motion of the image: a few outliers exceed it.
MAX_MOTION_PX: Final = 10.0
"""Image motion, px, at which that of a landmark is clipped, so that one wrong landmark does not move the mean of a
neighbourhood."""


class Explained(NamedTuple):
    """How far a motion explains a pair, by M landmarks and the cells `(R, C)`."""

    motion_px: float  #: Quantile `MOTION_QUANTILE` of the image motion of the landmarks, px; 0 without landmarks.
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
    """Return whether a cell of a number is set; False outside."""
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
        motion_px=reorder_to_rank(known_px[:known], int(MOTION_QUANTILE * known)) if known else 0.0,
        cell_index=cell,
        on_static=stays,
        on_fixed=fixed,
        unexplained=rest,
        unexplained_fraction=rest_count / max(in_view, 1),
        fixed_cells=fixed_cells,
        contradicting_fraction=contradicting / max(rows * columns, 1),
    )
