"""A start for the pose where prediction fails: points of the last good picture found again, then a robust pose."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, GreyImage


class WellSeen(NamedTuple):
    """A left picture in which most landmarks were found.

    Attributes:
        left: `(H, W)` uint8.
        seen: `(N, 2)` where the points were seen; NaN where not.
        points: `(N, 3)` metres, world; NaN where infinitely far.
    """

    left: GreyImage
    seen: FloatArray
    points: FloatArray


def pose_by_flow(
    before: GreyImage, now: GreyImage, seen: FloatArray, points: FloatArray, camera: FloatArray, fewest: int
) -> tuple[FloatArray, FloatArray] | None:
    """Find the pose of a picture from points seen in an earlier one.

    Pyramidal optical flow with a check backwards (Bouguet 2001), then a perspective pose by random samples.

    Args:
        before: `(H, W)` uint8, the earlier left picture.
        now: `(H, W)` uint8, the left picture.
        seen: `(N, 2)` where the points were seen in the earlier picture; NaN where not.
        points: `(N, 3)` metres, world.
        camera: `(4,)` fx, fy, cx, cy.
        fewest: Fewest points that must agree.

    Returns:
        Rotation `(3, 3)`, camera to world, and position `(3,)`, metres; None where too few points agree.
    """
    known = np.isfinite(seen).all(axis=1) & np.isfinite(points).all(axis=1)
    if known.sum() < fewest:
        return None
    start = seen[known].astype(np.float32)[:, None]
    window, levels = (21, 21), int(np.clip(np.log2(min(now.shape) / 16), 2, 6))
    moved, found = _flow(before, now, start, window, levels)
    back, found_back = _flow(now, before, moved, window, levels)
    good = (found[:, 0] > 0) & (found_back[:, 0] > 0) & (np.abs(back - start).max(axis=(1, 2)) < 1.0)
    if good.sum() < fewest:
        return None
    return _pose(points[known][good], moved[good, 0].astype(np.float64), camera, fewest, 0.3)


def pose_by_descriptors(
    before: WellSeen, now: GreyImage, corners: FloatArray, camera: FloatArray, fewest: int
) -> tuple[FloatArray, FloatArray] | None:
    """Find the pose of a picture that was taken far from an earlier one, as after pictures that were lost.

    Upright SIFT descriptors (Lowe 2004) of one size, mutual best matches, then a perspective pose by random samples.

    Args:
        before: The earlier left picture.
        now: `(H, W)` uint8, the left picture.
        corners: `(M, 2)` places in the picture that may be points.
        camera: `(4,)` fx, fy, cx, cy.
        fewest: Fewest points that must agree.

    Returns:
        Rotation `(3, 3)`, camera to world, and position `(3,)`, metres; None where too few points agree.
    """
    seen, points = before.seen, before.points
    known = np.isfinite(seen).all(axis=1) & np.isfinite(points).all(axis=1)
    if min(int(known.sum()), len(corners)) < fewest:
        return None
    size = max(8.0, min(now.shape) / 32)
    sift = cv2.SIFT.create()
    _, old = sift.compute(before.left, [cv2.KeyPoint(float(u), float(v), size, 0.0) for u, v in seen[known]])
    _, new = sift.compute(now, [cv2.KeyPoint(float(u), float(v), size, 0.0) for u, v in corners])
    matches = cv2.BFMatcher(cv2.NORM_L2, crossCheck=True).match(old, new)
    if len(matches) < fewest:
        return None
    pairs = np.array([(match.queryIdx, match.trainIdx) for match in matches])
    return _pose(points[known][pairs[:, 0]], np.ascontiguousarray(corners[pairs[:, 1]]), camera, fewest, 0.05)


def _pose(
    points: FloatArray, places: FloatArray, camera: FloatArray, fewest: int, share: float
) -> tuple[FloatArray, FloatArray] | None:
    """Return the pose on which at least `fewest` and this share of the points agree."""
    matrix = np.array([[camera[0], 0, camera[2]], [0, camera[1], camera[3]], [0, 0, 1.0]])
    ok, rotvec, translation, inliers = cv2.solvePnPRansac(
        points, places, matrix, None, reprojectionError=3.0, iterationsCount=300 if share > 0.1 else 2000
    )
    if not ok or inliers is None or len(inliers) < max(fewest, share * len(points)):
        return None
    r_cw = np.asarray(cv2.Rodrigues(rotvec)[0], dtype=np.float64)
    return np.ascontiguousarray(r_cw.T), np.asarray(-(r_cw.T @ translation[:, 0]), dtype=np.float64)


def _flow(
    before: GreyImage, now: GreyImage, start: NDArray[np.float32], window: tuple[int, int], levels: int
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    moved, found, _ = cv2.calcOpticalFlowPyrLK(before, now, start, start.copy(), winSize=window, maxLevel=levels)
    return np.asarray(moved, dtype=np.float32), np.asarray(found, dtype=np.uint8)
