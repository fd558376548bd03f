"""The sliding window: no information is lost when a keyframe leaves."""

from __future__ import annotations

import numpy as np

from sfr_loc_map.geometry.camera import Pose, StereoCamera
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.localisation.backend.sliding_window import NewLandmarks, SlidingWindow
from sfr_loc_map.localisation.frontend.patch import SIDE, templates_of
from sfr_loc_map.localisation.frontend.pose_solver import StereoObservations
from sfr_loc_map.localisation.frontend.pyramid import build_pyramid

CAMERA = StereoCamera(400.0, 400.0, 256.0, 256.0, 0.15)
PYRAMID = build_pyramid(np.zeros((512, 512), np.uint8))
PER_KEYFRAME = 40
NOISE_PX = 0.2
SIGHT = np.array([0.0, 0.0, 0.25])


def rotation(index: int) -> np.ndarray:
    return matrix_from_rotvec([0.0, 0.01 * index, 0.005 * index])


def project(points: np.ndarray, index: int) -> np.ndarray:
    """Return where a keyframe sees points `(N, 3)`, u, v left, u, v right."""
    seen = (points - index * SIGHT) @ rotation(index)
    left = seen[:, :2] / seen[:, 2:] * [CAMERA.fx, CAMERA.fy] + [CAMERA.cx, CAMERA.cy]
    return np.column_stack((left, left[:, 0] - CAMERA.fx * CAMERA.baseline_m / seen[:, 2], left[:, 1]))


def filled(keyframes: int) -> SlidingWindow:
    """Return a window of keyframes that host landmarks and see all earlier ones, with noise, not adjusted yet."""
    random = np.random.default_rng(0)
    window = SlidingWindow.empty(CAMERA, keyframes)
    variance = np.array([NOISE_PX**2, 0.0, NOISE_PX**2])
    points = np.zeros((0, 3))
    for index in range(keyframes):
        count = len(points)
        observed = project(points, index) + random.normal(0.0, NOISE_PX, (count, 4))
        start = index * SIGHT + (random.normal(0.0, 0.002, 3) if index else 0.0)
        seen = StereoObservations(observed, np.broadcast_to(variance, (count, 2, 3)))
        window = window.with_keyframe(Pose(rotation(index), start), np.arange(count), seen)
        uv = np.rint(random.uniform(80.0, 430.0, (PER_KEYFRAME, 2)))
        depth = random.uniform(2.0, 12.0, PER_KEYFRAME)
        rays = np.column_stack((CAMERA.normalised(uv), np.ones(PER_KEYFRAME)))
        new = (rays * depth[:, None]) @ rotation(index).T + index * SIGHT
        observed = project(new, index) + random.normal(0.0, NOISE_PX, (PER_KEYFRAME, 4)) * [0.0, 0.0, 1.0, 1.0]
        inverse_depth = (observed[:, 0] - observed[:, 2]) / (CAMERA.fx * CAMERA.baseline_m)
        patches = np.zeros((PER_KEYFRAME, 3, SIDE**2), np.float32)
        variances = np.broadcast_to(variance, (PER_KEYFRAME, 2, 3))
        slopes, templates = np.zeros((PER_KEYFRAME, 2)), templates_of(patches)
        seen = StereoObservations(observed, variances)
        window = window.with_landmarks(PYRAMID, NewLandmarks(uv, inverse_depth, slopes, templates, seen))
        points = np.concatenate((points, new))
    return window


def test_marginalise_then_solve_is_the_joint_solve() -> None:
    """The oldest keyframe and its landmarks are eliminated first or together with all others: the same linear system.

    Both windows are linearised at the same poses and observations; the larger one keeps the oldest keyframe.
    """
    joint, short = filled(3), filled(2)
    # the third keyframe of the joint window enters the short one, whose oldest leaves with what the third saw of it
    _, host, marks, observed, variance, _ = joint.problem
    seen, own = np.arange(2 * PER_KEYFRAME), np.flatnonzero(host == 2)
    short = short.with_keyframe(joint.newest_pose, seen, StereoObservations(observed[seen, 2], variance[seen, 2]))
    patches, slopes = np.zeros((PER_KEYFRAME, 3, SIDE**2), np.float32), np.zeros((PER_KEYFRAME, 2))
    uv, rho = np.rint(marks[own, :2]), marks[own, 2]
    own_seen = StereoObservations(observed[own, 2], variance[own, 2])
    short = short.with_landmarks(PYRAMID, NewLandmarks(uv, rho, slopes, templates_of(patches), own_seen))
    assert (len(short.problem.keyframes.positions), len(joint.problem.keyframes.positions)) == (2, 3)
    joint_map = joint.adjusted(1)
    short_map = short.adjusted(1)
    joint = joint_map.window
    short = short_map.window
    (short_r, short_p), (joint_r, joint_p) = short.problem.keyframes, joint.problem.keyframes
    assert np.abs(joint_p[1:] - [SIGHT, 2 * SIGHT]).max() > 1e-4  # something was adjusted at all
    np.testing.assert_allclose(short_p, joint_p[1:], atol=1e-9)
    np.testing.assert_allclose(short_r, joint_r[1:], atol=1e-9)
    np.testing.assert_allclose(short_map.covariance, joint_map.covariance, rtol=1e-5, atol=1e-13)
    np.testing.assert_allclose(short.problem.uv_inverse_depth, joint.problem.uv_inverse_depth[host > 0], atol=1e-8)
