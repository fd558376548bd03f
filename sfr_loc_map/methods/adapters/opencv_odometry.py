"""Basic stereo odometry with OpenCV: corners, optical flow, and PnP between consecutive pairs.

Pyramidal Lucas-Kanade flow matches Shi-Tomasi corners to the right image, which gives their depth, and tracks them to
the next left image and back. The motion is estimated by PnP with RANSAC and refined on the inliers.

If no motion is found, the pair is lost, and the odometry continues from the last known pose. Later poses then lack the
motion of the lost pairs. If a pair has no corners, such as black images, the motions to and from this pair are lost.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray

if TYPE_CHECKING:
    from sfr_loc_map.methods.child.loop import Answer, Order, Setup

# Chosen for ground with little texture: more and weaker corners than in the tutorials of OpenCV (quality 0.01 to 0.3).
MAX_CORNERS = 2000  #: Largest number of corners of an image.
QUALITY = 0.003  #: Smallest response of a corner, as a fraction of the largest response in the image.
SPACING_PX = 8.0  #: Smallest distance between two corners.
RETURN_PX = 1.0  #: Largest distance of a corner from its position after forward and backward flow.
ROW_PX = 1.0  #: Largest vertical disparity of a corner.
MIN_INLIERS = 8  #: Smallest number of points that confirm a motion, which three points determine.
MIN_DISPARITY_PX = 1.0  #: Smallest disparity of a corner, whose depth is otherwise too uncertain.
WINDOW_PX = 21  #: Width of the patches of the optical flow.
PYRAMID_LEVELS = 4  #: Highest level of the pyramid of the optical flow.
FLOW_ENDS = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 0.01)  #: At most 30 iterations, or a step of 0.01 px.
RANSAC_ITERATIONS = 200  #: Maximum number of iterations of the search for inliers of PnP.
RANSAC_ERROR_PX = 1.0  #: Largest reprojection error of an inlier.
RANSAC_CONFIDENCE = 0.999  #: Confidence at which the search ends.

Corners = NDArray[np.float32]


def flow(image: NDArray[np.uint8], other: NDArray[np.uint8], corners: Corners) -> tuple[Corners, NDArray[np.bool_]]:
    """Return the positions of corners `(N, 2)` in another image, and whether they were found."""
    positions, found, _ = cv2.calcOpticalFlowPyrLK(
        image,
        other,
        corners,
        np.empty(0, np.float32),
        winSize=(WINDOW_PX, WINDOW_PX),
        maxLevel=PYRAMID_LEVELS,
        criteria=FLOW_ENDS,
    )
    return np.asarray(positions, np.float32), np.asarray(found)[:, 0] == 1


class OpenCvOdometry:
    """Stereo odometry as a reference method."""

    version = cv2.__version__

    def __init__(self, setup: Setup) -> None:
        """Read the camera from the setup, and warm up on noise so that no call includes the start of threads."""
        camera = setup["camera"]
        fx, fy, cx, cy = camera["fx"], camera["fy"], camera["cx"], camera["cy"]
        self._camera_matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        self._focal_baseline = fx * camera["baseline_m"]
        T_rb_left = np.reshape(setup["T_rb_left"], (4, 4))
        self._T_ds_first_left = np.reshape(setup["T_ds_rb"], (4, 4)) @ T_rb_left
        self._T_left_rb = np.linalg.inv(T_rb_left)
        noise = np.random.default_rng(0).integers(0, 255, (camera["height"], camera["width"])).astype(np.uint8)
        self._reset()
        for shift in (0, 2):
            self._step(np.roll(noise, shift, 1), np.roll(noise, shift - 4, 1))
        self._reset()

    def _reset(self) -> None:
        self._pose = np.eye(4)
        self._previous: tuple[NDArray[np.uint8], NDArray[np.float32], FloatArray] | None = None
        cv2.setRNGSeed(1)

    def prepare(
        self, left: NDArray[np.uint8], right: NDArray[np.uint8], order: Order
    ) -> Callable[[], FloatArray | None]:
        """Return the call."""
        return lambda: self._step(left, right)

    def report(self, answer: FloatArray | None, order: Order) -> Answer:
        """Return the pose of RB in DS; None if lost."""
        if answer is None:
            return {"T_ds_rb": None}
        return {"T_ds_rb": (self._T_ds_first_left @ answer @ self._T_left_rb).ravel().tolist()}

    def _step(self, left: NDArray[np.uint8], right: NDArray[np.uint8]) -> FloatArray | None:
        """Return the pose `(4, 4)` of the left camera in the first left camera; None if unknown."""
        moved = np.eye(4) if self._previous is None else self._motion(left)
        if moved is not None:
            self._pose = self._pose @ moved
        self._previous = (left, *self._points(left, right))
        return None if moved is None else self._pose

    def _points(self, left: NDArray[np.uint8], right: NDArray[np.uint8]) -> tuple[NDArray[np.float32], FloatArray]:
        """Return corners `(N, 2)` and the points `(N, 3)` of these corners in the left camera, metres."""
        found_corners: NDArray[np.generic] | None = cv2.goodFeaturesToTrack(left, MAX_CORNERS, QUALITY, SPACING_PX)
        if found_corners is None:
            return np.zeros((0, 2), np.float32), np.zeros((0, 3))
        corners = np.reshape(found_corners, (-1, 2)).astype(np.float32)
        partners, found = flow(left, right, corners)
        disparity = corners[:, 0] - partners[:, 0]
        good = found & (np.abs(corners[:, 1] - partners[:, 1]) < ROW_PX) & (disparity > MIN_DISPARITY_PX)
        corners = np.ascontiguousarray(corners[good])
        depth = self._focal_baseline / disparity[good].astype(np.float64)
        rays = np.column_stack((corners, np.ones(len(corners)))) @ np.linalg.inv(self._camera_matrix).T
        return corners, rays * depth[:, None]

    def _motion(self, left: NDArray[np.uint8]) -> FloatArray | None:
        """Return the pose `(4, 4)` of the left camera in the previous left camera; None with too few inliers."""
        assert self._previous is not None
        image, corners, points = self._previous
        if len(corners) < MIN_INLIERS:
            return None
        tracked, found_forth = flow(image, left, corners)
        returned, found_back = flow(left, image, tracked)
        good = found_forth & found_back & (np.linalg.norm(returned - corners, axis=1) < RETURN_PX)
        points, tracked = points[good], tracked[good]
        if len(tracked) < MIN_INLIERS:
            return None
        solved, rotvec, translation, inliers = cv2.solvePnPRansac(
            points,
            tracked,
            self._camera_matrix,
            None,
            iterationsCount=RANSAC_ITERATIONS,
            reprojectionError=RANSAC_ERROR_PX,
            confidence=RANSAC_CONFIDENCE,
        )
        if not solved or inliers is None or len(inliers) < MIN_INLIERS:
            return None
        chosen = inliers[:, 0]
        rotvec, translation = cv2.solvePnPRefineLM(
            points[chosen], tracked[chosen], self._camera_matrix, None, rotvec, translation
        )
        T_now_before = np.eye(4)
        T_now_before[:3, :3], T_now_before[:3, 3] = cv2.Rodrigues(rotvec)[0], translation[:, 0]
        return np.asarray(np.linalg.inv(T_now_before))


open_method = OpenCvOdometry
