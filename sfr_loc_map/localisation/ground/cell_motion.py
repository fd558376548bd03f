"""Comparison of a pose with the changed and the stationary cells of the left image (`cell_change`).

Stationary cells for which the pose predicts image motion are fixed to the camera. Changed cells for which the pose
predicts no motion contradict the pose. Outliers in view that are not fixed to the camera are unexplained.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, Mask
from sfr_loc_map.geometry.camera import Pose, StereoCamera
from sfr_loc_map.jit import jit_fast, jit_fast_inline, jit_fast_ir_inline
from sfr_loc_map.localisation.frontend.landmarks import BORDER, MIN_INVERSE_DEPTH
from sfr_loc_map.localisation.frontend.pose_solver import LandmarkEstimates
from sfr_loc_map.localisation.frontend.projection import MIN_SCALED_DEPTH, component, point_from
from sfr_loc_map.localisation.ground.cell_change import CELL, Change
from sfr_loc_map.localisation.small_linalg import reorder_to_rank

NEAR: Final = 4
"""Number of cells to each side whose landmarks predict the image motion of a cell. This neighbourhood of 144 x 144 px
contains about a hundred landmarks in an image of 512 x 512 px."""
STATIONARY_PX: Final = 0.25
"""Maximum predicted image motion of a stationary cell, px. It is below the motion that is detected as a change."""
MOVED_PX: Final = 2.0  #: Minimum predicted image motion of a moving cell, px: six times what is detected as a change.
MOTION_QUANTILE: Final = 0.9  #: Quantile of the landmarks' image motion that is reported; outliers may exceed it.
MAX_MOTION_PX: Final = 10.0
"""Maximum image motion of a landmark, px. Larger motions are clipped, so that one wrong landmark does not dominate the
mean of a neighbourhood."""


class Agreement(NamedTuple):
    """Agreement of a pose with a pair, for M landmarks and R x C cells."""

    motion_px: float  #: Quantile `MOTION_QUANTILE` of the image motion of the landmarks, px; 0 without landmarks.
    cell_index: NDArray[np.intp]  #: `(M,)` numbers of the cells that contain the landmarks' projections; R * C outside.
    host_cell_index: NDArray[np.intp]  #: `(M,)` numbers of the cells that contain the host pixels; R * C outside.
    are_moved: Mask  #: `(M,)` landmarks for which the pose predicts an image motion above `MOVED_PX`.
    #: `(M,)` landmarks whose host pixels are in stationary cells. A landmark that is fixed to the camera stays at its
    #: host pixel.
    on_stationary: Mask
    on_fixed: Mask  #: `(M,)` outliers whose host pixels are in cells fixed to the camera.
    unexplained: Mask  #: `(M,)` outliers in view whose host pixels and projections are outside all fixed cells.
    unexplained_fraction: float  #: Fraction of `unexplained` among the landmarks in view.
    fixed_cells: Mask  #: `(R, C)` cells fixed to the camera: stationary although the pose predicts motion.
    contradicting_fraction: float  #: Fraction of all cells that changed although the pose predicts no motion.

    @property
    def moves_image(self) -> bool:
        """Whether the pose moves the image relative to the earlier image."""
        return self.motion_px > MOVED_PX

    def cells(self, landmarks: Mask) -> Mask:
        """Return the cells `(R, C)` that contain the projections of the landmarks in a mask `(M,)`."""
        return _cells_of(self.cell_index[landmarks], self.fixed_cells.shape)

    def host_cells(self, landmarks: Mask) -> Mask:
        """Return the cells `(R, C)` that contain the host pixels of the landmarks in a mask `(M,)`."""
        return _cells_of(self.host_cell_index[landmarks], self.fixed_cells.shape)


def _cells_of(numbers: NDArray[np.intp], shape: tuple[int, ...]) -> Mask:
    """Return the cells `(R, C)` with some numbers; the number R * C is outside all cells."""
    count = math.prod(shape)
    found = np.bincount(numbers, minlength=count + 1)
    return found[:count].reshape(shape) > 0


@jit_fast_inline
def _cell_number(u: float, v: float, rows: int, columns: int) -> int:
    """Return the number of the cell that contains a pixel; rows * columns outside all cells and for NaN."""
    if not (0.0 <= u < CELL * columns and 0.0 <= v < CELL * rows):
        return rows * columns
    return int(v) // CELL * columns + int(u) // CELL


@jit_fast_inline
def _is_set(cells: Mask, cell: int) -> bool:
    """Return whether the cell with a given number is set; False for a number outside."""
    return cell < cells.size and bool(cells[cell // cells.shape[1], cell % cells.shape[1]])


class _Neighbourhood(NamedTuple):
    """Sum and minimum of the values around a cell."""

    total: float
    smallest: float


@jit_fast_inline
def _around(values: FloatArray, row: int, column: int, reach: int) -> _Neighbourhood:
    """Return the sum and the minimum of the values up to `reach` cells away.

    Numba's own `sum` and `min` would load scipy.linalg.
    """
    total = 0.0
    smallest = np.inf
    for i in range(max(row - reach, 0), min(row + reach + 1, values.shape[0])):
        for j in range(max(column - reach, 0), min(column + reach + 1, values.shape[1])):
            total += values[i, j]
            smallest = min(smallest, values[i, j])
    return _Neighbourhood(total, smallest)


class _ProjectedPixel(NamedTuple):
    """Projection of a landmark into the left image, pixels; NaN behind the camera."""

    u: float
    v: float


@jit_fast_ir_inline
def _project(pose: Pose, landmarks: LandmarkEstimates, n: int, camera: StereoCamera) -> _ProjectedPixel:
    """Project a landmark. Its inverse depth is at least `MIN_INVERSE_DEPTH`."""
    inverse_depth = max(landmarks.inverse_depth[n], MIN_INVERSE_DEPTH)
    point = point_from(pose, landmarks.hosts, n, landmarks.rays[n, 0], landmarks.rays[n, 1], inverse_depth)
    depth = component(pose.rotation, 2, point)
    if depth <= MIN_SCALED_DEPTH:
        depth = np.nan
    u = camera.fx * component(pose.rotation, 0, point) / depth + camera.cx
    v = camera.fy * component(pose.rotation, 1, point) / depth + camera.cy
    return _ProjectedPixel(u, v)


class _LandmarkMotion(NamedTuple):
    """Image motion of M landmarks between two poses."""

    px: FloatArray  #: `(M,)` length, px; NaN for a landmark behind a camera.
    uv: FloatArray  #: `(M, 2)` projections at the second pose, px; NaN behind the camera.


class _CellMotion(NamedTuple):
    """Image motion of the landmarks in each of R x C cells; motions above `MAX_MOTION_PX` are clipped."""

    total: FloatArray  #: `(R, C)` sum of the motions, px.
    landmarks: FloatArray  #: `(R, C)` number of landmarks.
    smallest: FloatArray  #: `(R, C)` smallest motion, px; `MAX_MOTION_PX` without landmarks.


@jit_fast_ir_inline
def _landmark_motion(start: Pose, end: Pose, landmarks: LandmarkEstimates, camera: StereoCamera) -> _LandmarkMotion:
    """Return the image motion of landmarks between two poses."""
    count = len(landmarks.inverse_depth)
    px = np.full(count, np.nan)
    uv = np.empty((count, 2))
    for n in range(count):
        now = _project(end, landmarks, n, camera)
        before = _project(start, landmarks, n, camera)
        px[n] = np.hypot(now.u - before.u, now.v - before.v)
        uv[n, 0] = now.u
        uv[n, 1] = now.v
    return _LandmarkMotion(px, uv)


@jit_fast_ir_inline
def _quantile(motion_px: FloatArray) -> float:
    """Return the quantile `MOTION_QUANTILE` of the image motions `(M,)` that are not NaN; 0 if there are none."""
    finite_px = np.empty(len(motion_px))
    count = 0
    for n in range(len(motion_px)):
        if not np.isnan(motion_px[n]):
            finite_px[count] = motion_px[n]
            count += 1
    return reorder_to_rank(finite_px[:count], int(MOTION_QUANTILE * count)) if count else 0.0


@jit_fast_ir_inline
def _are_in_view(motion: _LandmarkMotion, inliers: Mask, shape: tuple[int, int], far_px: float) -> Mask:
    """Return which landmarks `(M,)` are in the image, without outliers that move by `far_px` or more."""
    height, width = shape
    in_view = np.zeros(len(inliers), np.bool_)
    for n in range(len(inliers)):
        is_evidence = inliers[n] or motion.px[n] < far_px
        is_inside = BORDER < motion.uv[n, 0] < width - 1 - BORDER and BORDER < motion.uv[n, 1] < height - 1 - BORDER
        in_view[n] = is_evidence and is_inside
    return in_view


@jit_fast_ir_inline
def _cell_motion(motion_px: FloatArray, cells: NDArray[np.intp], in_view: Mask, rows: int, columns: int) -> _CellMotion:
    """Return the image motion in each cell, of the landmarks in view. `cells` are their cell numbers."""
    total = np.zeros((rows, columns))
    count = np.zeros((rows, columns))
    smallest = np.full((rows, columns), MAX_MOTION_PX)
    for n in range(len(cells)):
        if in_view[n] and cells[n] < rows * columns:
            row = cells[n] // columns
            column = cells[n] % columns
            total[row, column] += min(motion_px[n], MAX_MOTION_PX)
            count[row, column] += 1.0
            smallest[row, column] = min(motion_px[n], smallest[row, column])
    return _CellMotion(total, count, smallest)


@jit_fast_ir_inline
def _fixed_cells(motion: _CellMotion, stationary: Mask) -> Mask:
    """Return the stationary cells in which the pose predicts image motion.

    Image motion varies from cell to cell near the focus of expansion, so the pose must predict motion for every
    landmark in the cell and its neighbours.
    """
    fixed = np.zeros(stationary.shape, np.bool_)
    for row in range(stationary.shape[0]):
        for column in range(stationary.shape[1]):
            if stationary[row, column]:
                has_landmarks = _around(motion.landmarks, row, column, 1).total > 0.0
                fixed[row, column] = has_landmarks and _around(motion.smallest, row, column, 1).smallest > MOVED_PX
    return fixed


@jit_fast_ir_inline
def _contradicting_count(motion: _CellMotion, changed: Mask) -> int:
    """Return the number of changed cells in which the pose predicts no image motion."""
    contradicting = 0
    for row in range(changed.shape[0]):
        for column in range(changed.shape[1]):
            if changed[row, column]:
                near = _around(motion.landmarks, row, column, NEAR).total
                contradicting += _around(motion.total, row, column, NEAR).total < STATIONARY_PX * near
    return contradicting


@jit_fast
def image_motion(start: Pose, end: Pose, landmarks: LandmarkEstimates, camera: StereoCamera) -> float:
    """Return the quantile `MOTION_QUANTILE` of the image motion of landmarks, px; 0 without landmarks."""
    return _quantile(_landmark_motion(start, end, landmarks, camera).px)


@jit_fast
def agreement_of(
    pose: Pose,
    reference: Pose,
    landmarks: LandmarkEstimates,
    host_uv: FloatArray,
    inliers: Mask,
    change: Change,
    camera: StereoCamera,
    shape: tuple[int, int],
    far_px: float,
) -> Agreement:
    """Compare a pose with the landmarks and the cells of an image.

    Args:
        pose: Pose of the left camera at the image.
        reference: Pose of the left camera at the earlier image of the change.
        landmarks: The M landmarks.
        host_uv: `(M, 2)` host pixels of their patches.
        inliers: `(M,)` landmarks that agree with the pose.
        change: Cells of the image that changed or are stationary since the earlier image.
        camera: The camera.
        shape: Height and width of the image.
        far_px: Image motion, px, from which a landmark that is not an inlier is ignored instead of counted as an
            outlier.
    """
    count = len(inliers)
    rows, columns = change.changed.shape
    motion = _landmark_motion(reference, pose, landmarks, camera)
    in_view = _are_in_view(motion, inliers, shape, far_px)
    cells = np.empty(count, np.intp)
    host_cells = np.empty(count, np.intp)
    are_moved = np.zeros(count, np.bool_)
    for n in range(count):
        cells[n] = _cell_number(motion.uv[n, 0], motion.uv[n, 1], rows, columns)
        host_cells[n] = _cell_number(host_uv[n, 0], host_uv[n, 1], rows, columns)
        are_moved[n] = motion.px[n] > MOVED_PX  # False for NaN
    cell_motion = _cell_motion(motion.px, cells, in_view, rows, columns)
    fixed_cells = _fixed_cells(cell_motion, change.stationary)
    on_stationary = np.zeros(count, np.bool_)
    on_fixed = np.zeros(count, np.bool_)
    unexplained = np.zeros(count, np.bool_)
    unexplained_count = 0
    in_view_count = 0
    for n in range(count):
        on_stationary[n] = _is_set(change.stationary, host_cells[n])
        if not inliers[n]:
            on_fixed[n] = _is_set(fixed_cells, host_cells[n])
            unexplained[n] = in_view[n] and not (on_fixed[n] or _is_set(fixed_cells, cells[n]))
        unexplained_count += unexplained[n]
        in_view_count += in_view[n]
    return Agreement(
        motion_px=_quantile(motion.px),
        cell_index=cells,
        host_cell_index=host_cells,
        are_moved=are_moved,
        on_stationary=on_stationary,
        on_fixed=on_fixed,
        unexplained=unexplained,
        unexplained_fraction=unexplained_count / max(in_view_count, 1),
        fixed_cells=fixed_cells,
        contradicting_fraction=_contradicting_count(cell_motion, change.changed) / max(rows * columns, 1),
    )
