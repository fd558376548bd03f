"""A start for the pose where prediction fails: optical flow from the last good picture, then a robust pose."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.rotation import FloatArray
from sfr_loc_map.geometry.stereo import GreyImage


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
    matrix = np.array([[camera[0], 0, camera[2]], [0, camera[1], camera[3]], [0, 0, 1.0]])
    ok, rotvec, translation, inliers = cv2.solvePnPRansac(
        points[known][good], moved[good, 0].astype(np.float64), matrix, None, reprojectionError=3.0, iterationsCount=300
    )
    if not ok or inliers is None or len(inliers) < max(fewest, 0.3 * good.sum()):
        return None
    r_cw = np.asarray(cv2.Rodrigues(rotvec)[0], dtype=np.float64)
    return np.ascontiguousarray(r_cw.T), np.asarray(-(r_cw.T @ translation[:, 0]), dtype=np.float64)


def _flow(
    before: GreyImage, now: GreyImage, start: NDArray[np.float32], window: tuple[int, int], levels: int
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    moved, found, _ = cv2.calcOpticalFlowPyrLK(before, now, start, start.copy(), winSize=window, maxLevel=levels)
    return np.asarray(moved, dtype=np.float32), np.asarray(found, dtype=np.uint8)
