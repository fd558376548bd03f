"""A plain stereo odometry as OpenCV's own building blocks give it: corners, optical flow, PnP from pair to pair.

Corners (Shi-Tomasi) get their depth by pyramidal Lucas-Kanade flow to the right picture, are followed by the same flow
to the next left picture and back, and give the motion by PnP with RANSAC, refined on its inliers.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray

FEATURES = 2000
QUALITY, SPACING_PX = 0.003, 8.0
RETURN_PX = 1.0
"""Largest distance of a corner from where the flow forth and back brings it."""
ROW_PX = 1.0
"""Largest distance of the rows of a corner in both pictures."""
FEWEST = 8

Corners = NDArray[np.float32]


def flow(image: NDArray[np.uint8], other: NDArray[np.uint8], corners: Corners) -> tuple[Corners, NDArray[np.bool_]]:
    """Return where corners `(N, 2)` of an image are in another one, and whether they were found."""
    places, found, _ = cv2.calcOpticalFlowPyrLK(
        image, other, corners, np.empty(0, np.float32), winSize=(21, 21), maxLevel=4, criteria=(3, 30, 0.01)
    )
    return np.asarray(places, np.float32), np.asarray(found)[:, 0] == 1


class Odometry:
    """The recipe; `step` gives the pose of the left camera in its first one, None where there is none."""

    def __init__(self, setup: Mapping[str, Any]) -> None:
        """Take the camera from the setup."""
        fx, fy, cx, cy = (float(setup[name]) for name in ("fx", "fy", "cx", "cy"))
        self._k = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        self._scale = fx * float(setup["baseline_m"])
        self._pose = np.eye(4)
        self._before: tuple[NDArray[np.uint8], NDArray[np.float32], FloatArray] | None = None
        cv2.setRNGSeed(1)

    def step(self, left: NDArray[np.uint8], right: NDArray[np.uint8]) -> FloatArray | None:
        """Return the pose `(4, 4)` at a pair, None where it is not known."""
        moved = np.eye(4) if self._before is None else self._motion(left)
        if moved is not None:
            self._pose = self._pose @ moved
        self._before = (left, *self._points(left, right))
        return None if moved is None else self._pose

    def _points(self, left: NDArray[np.uint8], right: NDArray[np.uint8]) -> tuple[NDArray[np.float32], FloatArray]:
        """Return corners `(N, 2)` and their places `(N, 3)`, metres, in the left camera."""
        corners = np.reshape(cv2.goodFeaturesToTrack(left, FEATURES, QUALITY, SPACING_PX), (-1, 2)).astype(np.float32)
        if not len(corners):
            return corners, np.zeros((0, 3))
        partners, found = flow(left, right, corners)
        disparity = corners[:, 0] - partners[:, 0]
        good = found & (np.abs(corners[:, 1] - partners[:, 1]) < ROW_PX) & (disparity > 1.0)
        corners = np.ascontiguousarray(corners[good])
        depth = self._scale / disparity[good].astype(np.float64)
        rays = np.column_stack((corners, np.ones(len(corners)))) @ np.linalg.inv(self._k).T
        return corners, rays * depth[:, None]

    def _motion(self, left: NDArray[np.uint8]) -> FloatArray | None:
        """Return the pose `(4, 4)` of the camera now in the one before, None where too few corners agree."""
        assert self._before is not None
        image, corners, points = self._before
        if len(corners) < FEWEST:
            return None
        now, there = flow(image, left, corners)
        again, back = flow(left, image, now)
        good = there & back & (np.linalg.norm(again - corners, axis=1) < RETURN_PX)
        points, now = points[good], now[good]
        if len(now) < FEWEST:
            return None
        solved, turn, shift, inliers = cv2.solvePnPRansac(
            points, now, self._k, None, iterationsCount=200, reprojectionError=1.0, confidence=0.999
        )
        if not solved or inliers is None or len(inliers) < FEWEST:
            return None
        chosen = inliers[:, 0]
        turn, shift = cv2.solvePnPRefineLM(points[chosen], now[chosen], self._k, None, turn, shift)
        before_to_now = np.eye(4)
        before_to_now[:3, :3], before_to_now[:3, 3] = cv2.Rodrigues(turn)[0], shift[:, 0]
        return np.asarray(np.linalg.inv(before_to_now))


class OpenCvOdometry:
    """The recipe as a peer."""

    version = cv2.__version__

    def __init__(self, setup: Mapping[str, Any]) -> None:
        """Warm up on noise, so that no call pays for the start of threads."""
        shape = (int(setup["height"]), int(setup["width"]))
        noise = np.random.default_rng(0).integers(0, 255, shape).astype(np.uint8)
        warm = Odometry(setup)
        for shift in (0, 2):
            warm.step(np.roll(noise, shift, 1), np.roll(noise, shift - 4, 1))
        self._odometry = Odometry(setup)

    def prepare(
        self, left: NDArray[np.uint8], right: NDArray[np.uint8], order: Mapping[str, Any]
    ) -> Callable[[], FloatArray | None]:
        """Return the call."""
        return lambda: self._odometry.step(left, right)

    def report(self, answer: FloatArray | None, order: Mapping[str, Any]) -> dict[str, Any]:
        """Return the pose as 16 numbers, None when lost."""
        return {"pose": None if answer is None else answer.ravel().tolist()}


open_peer = OpenCvOdometry
