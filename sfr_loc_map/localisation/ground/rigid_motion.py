"""Rigid motions in a pair: how landmarks are tracked and searched for, and how far a motion agrees with the pair.

`agreement_of` compares the pose of a motion with the changed and the stationary cells of the left image
(`cell_change`). Stationary cells for which the pose predicts image motion are fixed to the camera. Changed cells for
which the pose predicts no motion contradict the pose. Outliers in view that are not fixed to the camera are
unexplained.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, Mask
from sfr_loc_map.geometry.camera import Pose, StereoCamera
from sfr_loc_map.jit import jit_fast, jit_fast_inline, jit_fast_ir_inline
from sfr_loc_map.localisation.frontend.landmarks import ALIGNED_LANDMARKS, BORDER, MIN_INVERSE_DEPTH, Landmarks
from sfr_loc_map.localisation.frontend.pose_solver import LandmarkEstimates
from sfr_loc_map.localisation.frontend.projection import MIN_SCALED_DEPTH, component, point_from
from sfr_loc_map.localisation.frontend.right_camera import RightCameraOffset
from sfr_loc_map.localisation.frontend.stereo_frame import StereoFrame
from sfr_loc_map.localisation.frontend.tracking import Tracker, Tracks
from sfr_loc_map.localisation.ground.cell_change import CELL, Change
from sfr_loc_map.localisation.motion_model import Prediction
from sfr_loc_map.localisation.motion_size import NO_MOTION, MotionSize
from sfr_loc_map.localisation.relocalisation import RecoveryImages, Relocaliser
from sfr_loc_map.localisation.small_linalg import reorder_to_rank

NEAR: Final = 4
"""Number of cells to each side whose landmarks predict the image motion of a cell. This neighbourhood of 144 x 144 px
contains about a hundred landmarks in an image of 512 x 512 px."""
STATIONARY_PX: Final = 0.25
"""Maximum predicted image motion of a stationary cell, px. A motion of this size is not detected as a change."""
MOVED_PX: Final = 2.0  #: Minimum predicted image motion of a moving cell, px: six times what is detected as a change.
MOTION_QUANTILE: Final = 0.9
"""Quantile of the image motion of the landmarks that counts as the image motion. Outliers may exceed the quantile."""
MAX_MOTION_PX: Final = 10.0
"""Maximum image motion of a landmark, px. Larger motions are clipped, so that one wrong landmark does not dominate the
mean of a neighbourhood."""
FAR_RATIO: Final = 0.06
"""Image motion per pair, as a fraction of the width, above which a landmark is often not found again. Such an outlier
does not count as unexplained. Slightly above the optical flow that triggers a keyframe
(`keyframes.KEYFRAME_FLOW_RATIO`)."""
MIN_AGREEMENT: Final = 0.3
"""Minimum fraction of the landmarks searched for that a motion must explain to be found. If larger, another motion
among many outliers is missed. If smaller, chance agreement of outliers counts as a motion and degrades good pairs."""
CONVINCING: Final = 0.6
"""Minimum fraction of the landmarks searched for that a motion must explain to be accepted without further tests. The
value is above one half: the majority agrees. If smaller, slow motions near the main motion are accepted. If larger,
fewer motions are accepted by this test alone; the others must also differ from the main motion in the image
(`evidence.MIN_DIFFERENCE_PX`)."""


# ---- agreement of a pose with the landmarks and the cells of a pair


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


# ---- motions


class Motion(NamedTuple):
    """A rigid motion in a pair."""

    tracks: Tracks  #: Tracks whose inliers follow the motion.
    agreement: Agreement  #: How far the motion agrees with the pair.

    @property
    def is_moving(self) -> bool:
        """Whether the pose is trusted and the image moved."""
        return self.tracks.is_trusted and self.agreement.moves_image


class MotionTools(NamedTuple):
    """Tools that track and search for motions, without state between calls."""

    tracker: Tracker
    relocaliser: Relocaliser
    camera: StereoCamera
    shape: tuple[int, int]  #: Height and width of the images.
    min_tracked: int  #: Minimum number of landmarks that agree on a motion.


class ComparedPair(NamedTuple):
    """A pair and its comparison with an earlier image, cell by cell. Its methods track and search for motions."""

    tools: MotionTools
    frame: StereoFrame
    prediction: Prediction
    offset: RightCameraOffset  #: Offset of the right camera.
    recovery: RecoveryImages
    change: Change  #: Cells that changed, and cells that stayed, since the earlier image.
    earlier_pose: Pose  #: Pose of the earlier image.
    far_px: float  #: Image motion, px, from which an outlier does not count as unexplained (`FAR_RATIO`).

    def motion(self, tracks: Tracks) -> Motion:
        """Return the motion of some tracks, from the earlier image to their pose."""
        landmarks = tracks.landmarks
        agreement = agreement_of(
            tracks.pose,
            self.earlier_pose,
            landmarks.estimates,
            landmarks.planes.uv,
            tracks.inliers,
            self.change,
            self.tools.camera,
            self.tools.shape,
            self.far_px,
        )
        return Motion(tracks, agreement)

    def tracked_from(self, landmarks: Landmarks, start: Pose) -> Motion:
        """Track landmarks from a pose, and return their motion."""
        return self.motion(self.tools.tracker.refine(self.frame, landmarks, start, self.offset))

    def search(self, landmarks: Landmarks) -> Motion | None:
        """Search for one motion of some landmarks, from the guesses, then by optical flow; None if too few agree."""
        tracker = self.tools.tracker
        min_tracked = self.tools.min_tracked
        count = len(landmarks.rows)
        if count < min_tracked:
            return None
        start = tracker.align(self.frame.left, landmarks.thinned(ALIGNED_LANDMARKS), self.prediction.guesses)
        tracks = tracker.refine(self.frame, landmarks, start, self.offset)
        if tracks.inlier_count < CONVINCING * count:
            pose = self.tools.relocaliser.pose_by_flow(self.frame, self.recovery, landmarks)
            if pose is not None:
                by_flow = tracker.refine_from_afar(self.frame, landmarks, pose, self.offset)
                if by_flow.inlier_count > tracks.inlier_count:
                    tracks = by_flow
        if tracks.inlier_count < max(min_tracked, MIN_AGREEMENT * count):
            return None
        return self.motion(tracks)

    def image_motion_px(self, tracks: Tracks, *, start: Pose, end: Pose) -> float:
        """Return the image motion of the landmarks of some tracks between two poses, px."""
        return image_motion(start, end, tracks.landmarks.estimates, self.tools.camera)


# ---- the selected motion


class Exclusion(NamedTuple):
    """Landmarks and cells that do not move with the ground, as a pair shows."""

    rows: NDArray[np.intp]  #: `(N,)` window rows of landmarks.
    fixed: Mask  #: `(R, C)` cells that are fixed to the camera.
    dynamic: Mask  #: `(R, C)` cells that move differently from the ground.

    @classmethod
    def of_fixed(cls, rows: NDArray[np.intp], cells: Mask) -> Exclusion:
        """Return the exclusion of landmarks and cells that are fixed to the camera."""
        return cls(rows, cells, np.zeros(cells.shape, np.bool_))

    @classmethod
    def nothing(cls, shape: tuple[int, ...]) -> Exclusion:
        """Return an exclusion without landmarks and without cells, for a shape (R, C) of the cells."""
        return cls.of_fixed(np.zeros(0, np.intp), np.zeros(shape, np.bool_))


class Selection(NamedTuple):
    """The motion that is used as the ground's, and what does not follow this motion."""

    motion: Motion
    is_main: bool  #: Whether the motion is the main motion.
    exclusion: Exclusion  #: Landmarks and cells that do not move with the ground.
    other_distance: MotionSize = NO_MOTION  #: Distance to the pose of another possible motion; zero if none.
