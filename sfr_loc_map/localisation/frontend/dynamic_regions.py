"""What does not move with the ground: own body, dirt, moving objects.

Landmarks that a pose does not explain, those among them that are fixed to the camera, and the regions of the image
where they were, for as long as these hold.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage, GreyImage, Mask
from sfr_loc_map.geometry.camera import Pose, Poses, StereoCamera
from sfr_loc_map.jit import jit, jit_fast, jit_fast_ir_inline
from sfr_loc_map.localisation.frontend.landmarks import BORDER, MIN_INVERSE_DEPTH, Landmarks
from sfr_loc_map.localisation.frontend.patch import MIN_POWER, SIDE, Patch, half_width, normalise
from sfr_loc_map.localisation.frontend.tracking import StereoFrame, TrackingResult

MIN_FIXED_NCC = 0.8
"""Minimum normalised cross-correlation of a patch with the image where it was cut, if it is fixed to the camera."""
BESIDE_PX = 3  #: Distance at which such a patch must fit worse.
MAX_AMBIGUITY = 0.5  #: Maximum ratio of its `1 - correlation` where it was cut to that beside.
FIXED_LIFE, MOVING_LIFE = 10, 8
"""Pairs for which a region is left out after it was last seen to be fixed, or to move."""
MAX_MARKS = 4000
FLOW_WINDOW = (15, 15)
REACH = 1.25  #: Half side of the square around a mark, in spacings of landmarks.
MIN_MOTION_PX = 2.0  #: Image motion that distinguishes what is fixed to the camera from the ground.
MIN_FIXED = 12  #: Minimum number of landmarks that are taken as fixed to the camera.
MIN_FIXED_SHARE = 0.25  #: Minimum share of them among the unexplained landmarks: a few look fixed by chance.


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
    """Compare patches `(N, S * S)` with an image at the pixels `(N, 2)` where they were cut and `BESIDE_PX` beside.

    Returns the normalised cross-correlation there `(N, 2)`, and the best one beside in four directions; -1 where the
    patch leaves the image or one of both has no texture, and beside where it does not fit where it was cut: most do
    not, and nothing follows.
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


@jit
def stays(image: FloatImage, patches: Patch, uv: FloatArray) -> Mask:
    """Tell which patches `(N, S * S)` an image still shows at the pixels `(N, 2)` where they were cut, and only there.

    A patch that looks the same beside, as on a straight edge, says nothing.
    """
    found = fixed_correlation(image, patches, uv)
    here, beside = found[:, 0], found[:, 1]
    return (here > MIN_FIXED_NCC) & (1.0 - here < MAX_AMBIGUITY * (1.0 - beside))


class Marks(NamedTuple):
    """Points of regions that do not move with the ground."""

    uv: FloatArray  #: `(K, 2)` where they are in the last left image, pixels.
    patches: Patch  #: `(K, S * S)` what is seen there, if fixed.
    fixed: Mask  #: `(K,)` whether they are fixed to the camera.
    life: NDArray[np.int64]  #: `(K,)` pairs for which they still hold.

    def kept(self, which: Mask) -> Marks:
        """Return some of them."""
        return Marks(self.uv[which], self.patches[which], self.fixed[which], self.life[which])


class DynamicRegions:
    """Knows where the left image shows something that does not move with the ground.

    A region fixed to the camera holds for as long as its texture stays at its place, a moving one for a few pairs,
    carried on by optical flow.

    Attributes:
        mask: Left image `(H, W)` uint8, 0 where no landmark shall be made; None without regions.
        share: Share of the left image that is left out.
    """

    def __init__(self, shape: tuple[int, int], max_features: int) -> None:
        """Start without regions; the shape is (height, width), landmarks are as dense as so many in an image."""
        self._shape = shape
        self._reach = round(REACH * max(8.0, np.sqrt(shape[0] * shape[1] / max_features)))
        self._marks = Marks(
            np.zeros((0, 2)), np.zeros((0, SIDE * SIDE), np.float32), np.zeros(0, np.bool_), np.zeros(0, np.int64)
        )
        self.mask: NDArray[np.uint8] | None = None
        self.share = 0.0
        self._image: GreyImage | None = None

    def add(self, image: GreyImage, uv: FloatArray, fixed: Mask, patches: Patch) -> None:
        """Add pixels `(N, 2)` of an image that do not move with the ground, and the patches seen there, if fixed."""
        self._image = image
        before, life = self._marks, np.where(fixed, FIXED_LIFE, MOVING_LIFE)
        marks = Marks(
            np.concatenate((uv, before.uv)),
            np.concatenate((patches, before.patches)),
            np.concatenate((fixed, before.fixed)),
            np.concatenate((life, before.life)),
        )
        self._take(marks.kept(np.arange(len(marks.uv)) < MAX_MARKS))

    def update(self, image: GreyImage, smooth: FloatImage) -> None:
        """Carry the regions on to the next left image, which is also given smoothed, float32."""
        before, self._image, marks = self._image, image, self._marks
        uv, life = marks.uv.copy(), marks.life - 1
        fixed, moving = np.flatnonzero(marks.fixed), np.flatnonzero(~marks.fixed)
        holds = fixed_correlation(smooth, marks.patches[fixed], uv[fixed])[:, 0] > MIN_FIXED_NCC
        life[fixed[holds]] = FIXED_LIFE
        if len(moving) and before is not None:
            start = uv[moving].astype(np.float32)[:, None]
            moved, found, _ = cv2.calcOpticalFlowPyrLK(
                before, image, start, start.copy(), winSize=FLOW_WINDOW, maxLevel=3
            )
            uv[moving] = moved[:, 0]
            life[moving[found[:, 0] == 0]] = 0
        self._take(Marks(uv, marks.patches, marks.fixed, life).kept(life > 0))

    def _take(self, marks: Marks) -> None:
        """Draw a square around each mark."""
        self._marks, self.mask, self.share = marks, None, 0.0
        if not len(marks.uv):
            return
        height, width = self._shape
        free = np.full(self._shape, 255, np.uint8)
        column, row = np.rint(marks.uv).astype(int).T
        inside = (column >= 0) & (row >= 0) & (column < width) & (row < height)
        free[row[inside], column[inside]] = 0
        side = 2 * self._reach + 1
        self.mask = np.asarray(cv2.erode(free, np.ones((side, side), np.uint8)), np.uint8)
        self.share = float(np.count_nonzero(self.mask == 0) / self.mask.size)


class Unexplained(NamedTuple):
    """Landmarks that a pose does not explain."""

    uv: FloatArray  #: `(M, 2)` where the pose sees them in the left image, pixels; NaN behind the camera.
    in_view: Mask  #: `(M,)` landmarks that should be in view.
    rows: Mask  #: `(M,)` those of them that do not agree with the pose.
    fixed: Mask  #: `(M,)` landmarks that are still seen at their host pixel though the pose moves them.


def project(pose: Pose, landmarks: Landmarks, camera: StereoCamera) -> FloatArray:
    """Return the left pixels `(M, 2)` of landmarks; NaN behind the camera. Those at infinity are taken as far away."""
    hosts, rays, inverse_depth, _ = landmarks.estimates
    inverse_depth = np.maximum(inverse_depth, MIN_INVERSE_DEPTH)
    directions = np.einsum("nij,nj->ni", hosts.rotations, rays)
    scaled = (directions + inverse_depth[:, None] * (hosts.positions - pose.position)) @ pose.rotation
    depth = np.where(scaled[:, 2] > 1e-6, scaled[:, 2], np.nan)
    x, y = scaled[:, 0] / depth, scaled[:, 1] / depth
    return np.column_stack((camera.fx * x + camera.cx, camera.fy * y + camera.cy))


def stays_in(frame: StereoFrame, landmarks: Landmarks) -> Mask:
    """Tell which landmarks `(M,)` the left image still shows at their host pixels."""
    patches = np.ascontiguousarray(landmarks.patches[0].values[:, 0])
    return stays(frame.left[0].image, patches, landmarks.planes.uv)


@jit
def where_seen(
    pose: Pose,
    hosts: Poses,
    rays: FloatArray,
    inverse_depth: FloatArray,
    host_uv: FloatArray,
    camera: StereoCamera,
    shape: tuple[int, int],
) -> tuple[FloatArray, Mask, Mask]:
    """Return where a pose sees landmarks `(M, 2)`, which `(M,)` lie in an image of a shape, and which have moved.

    They have moved if that is away from their host pixels, or behind the camera. See `project`.
    """
    height, width = shape
    count = len(inverse_depth)
    in_view, moved = np.zeros(count, np.bool_), np.ones(count, np.bool_)
    direction, seen, uv = np.empty(3), np.empty(3), np.full((count, 2), np.nan)
    for n in range(count):
        rho = max(inverse_depth[n], MIN_INVERSE_DEPTH)
        for i in range(3):
            direction[i] = rho * (hosts.positions[n, i] - pose.position[i])
            for j in range(3):
                direction[i] += hosts.rotations[n, i, j] * rays[n, j]
        for j in range(3):
            seen[j] = 0.0
            for i in range(3):
                seen[j] += direction[i] * pose.rotation[i, j]
        if not seen[2] > 1e-6:
            continue
        u, v = camera.fx * seen[0] / seen[2] + camera.cx, camera.fy * seen[1] / seen[2] + camera.cy
        uv[n, 0], uv[n, 1] = u, v
        in_view[n] = BORDER < u < width - 1 - BORDER and BORDER < v < height - 1 - BORDER
        moved[n] = not (abs(u - host_uv[n, 0]) < MIN_MOTION_PX and abs(v - host_uv[n, 1]) < MIN_MOTION_PX)
    return uv, in_view, moved


def unexplained_by(result: TrackingResult, frame: StereoFrame, camera: StereoCamera) -> Unexplained:
    """Return the landmarks that a result does not explain."""
    landmarks, outliers = result.landmarks, ~result.inliers
    hosts, rays, inverse_depth, _ = landmarks.estimates
    host_uv = landmarks.planes.uv
    uv, in_view, moved = where_seen(result.pose, hosts, rays, inverse_depth, host_uv, camera, frame.image.shape)
    rows = in_view & outliers
    fixed = np.zeros(len(outliers), np.bool_)
    candidates = np.flatnonzero(outliers & moved)
    if len(candidates) >= MIN_FIXED:
        patches = landmarks.patches[0].values[candidates, 0]
        fixed[candidates] = stays(frame.left[0].image, patches, host_uv[candidates])
    if np.count_nonzero(fixed) < max(MIN_FIXED, MIN_FIXED_SHARE * np.count_nonzero(rows)):
        fixed[:] = False
    return Unexplained(uv, in_view, rows, fixed)
