"""The sliding window: what enters, what leaves, and that no information is lost when a keyframe leaves."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from sfr_loc_map.geometry.camera import Pose, StereoCamera
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.localisation.backend.sliding_window import HostedLandmarks, Observations, SlidingWindow
from sfr_loc_map.localisation.frontend.image_pyramid import build_pyramid
from sfr_loc_map.localisation.frontend.patch import SIDE, templates_of

CAMERA = StereoCamera(400.0, 400.0, 256.0, 256.0, 0.15)
PYRAMID = build_pyramid(np.zeros((512, 512), np.uint8))
PER_KEYFRAME = 40
KEYFRAMES = 4
NOISE_PX = 0.2
SIGHT = np.array([0.0, 0.0, 0.25])


def rotation(index: int) -> np.ndarray:
    return matrix_from_rotvec([0.0, 0.01 * index, 0.005 * index])


def project(points: np.ndarray, index: int) -> np.ndarray:
    """Return where a keyframe sees points `(N, 3)`, u, v left, u, v right."""
    seen = (points - index * SIGHT) @ rotation(index)
    left = seen[:, :2] / seen[:, 2:] * [CAMERA.fx, CAMERA.fy] + [CAMERA.cx, CAMERA.cy]
    return np.column_stack((left, left[:, 0] - CAMERA.fx * CAMERA.baseline_m / seen[:, 2], left[:, 1]))


def filled(size: int, seed: int = 0, keyframes: int = KEYFRAMES) -> SlidingWindow:
    """Return a window of keyframes that host landmarks and see all earlier ones, with noise, not adjusted yet."""
    random = np.random.default_rng(seed)
    window = SlidingWindow(CAMERA, size)
    variance = np.array([NOISE_PX**2, 0.0, NOISE_PX**2])
    points = np.zeros((0, 3))
    for index in range(keyframes):
        if index > size:  # those of the keyframe that left with the last one are gone
            points = points[PER_KEYFRAME:]
        count = len(points)
        observed = project(points, index) + random.normal(0.0, NOISE_PX, (count, 4))
        start = index * SIGHT + (random.normal(0.0, 0.002, 3) if index else 0.0)
        window.add_keyframe(
            Pose(rotation(index), start), np.arange(count), observed, np.broadcast_to(variance, (count, 2, 3))
        )
        uv = np.rint(random.uniform(80.0, 430.0, (PER_KEYFRAME, 2)))
        depth = random.uniform(2.0, 12.0, PER_KEYFRAME)
        rays = np.column_stack((CAMERA.normalised(uv), np.ones(PER_KEYFRAME)))
        new = (rays * depth[:, None]) @ rotation(index).T + index * SIGHT
        observed = project(new, index) + random.normal(0.0, NOISE_PX, (PER_KEYFRAME, 4)) * [0.0, 0.0, 1.0, 1.0]
        inverse_depth = (observed[:, 0] - observed[:, 2]) / (CAMERA.fx * CAMERA.baseline_m)
        hosted = HostedLandmarks.new(len(window) - 1, uv, inverse_depth, np.zeros((PER_KEYFRAME, 2)))
        patches = np.zeros((PER_KEYFRAME, 3, SIDE**2), np.float32)
        patches[:, 0, :2] = -index, index
        variances = np.broadcast_to(variance, (PER_KEYFRAME, 2, 3))
        window.add_landmarks(PYRAMID, hosted, templates_of(patches), observed, variances)
        points = np.concatenate((points, new))
    return window


def test_marginalise_then_solve_is_the_joint_solve() -> None:
    """The oldest keyframe and its landmarks are eliminated first or together with all others: the same linear system.

    Both windows are linearised at the same poses and observations; the larger one keeps the oldest keyframe.
    """
    joint, short = filled(3, keyframes=3), filled(2, keyframes=2)
    # the third keyframe of the joint window enters the short one, whose oldest leaves with what the third saw of it
    third = joint.observations
    seen = np.arange(2 * PER_KEYFRAME)
    short.add_keyframe(
        Pose(joint.keyframes.rotations[2], joint.keyframes.positions[2]),
        seen,
        third.uv[seen, 2],
        third.variance[seen, 2],
    )
    own = np.flatnonzero(joint.hosted.host == 2)
    hosted = HostedLandmarks.new(1, joint.hosted.uv[own], joint.hosted.uv_inverse_depth[own, 2], np.zeros((40, 2)))
    patches = np.zeros((40, 3, SIDE**2), np.float32)
    short.add_landmarks(PYRAMID, hosted, templates_of(patches), third.uv[own, 2], third.variance[own, 2])
    assert len(short) == 2
    assert len(joint) == 3
    for window in (joint, short):
        window.adjust(1)
    assert np.abs(joint.keyframes.positions[1:] - [SIGHT, 2 * SIGHT]).max() > 1e-4  # something was adjusted at all
    np.testing.assert_allclose(short.keyframes.positions, joint.keyframes.positions[1:], atol=1e-9)
    np.testing.assert_allclose(short.keyframes.rotations, joint.keyframes.rotations[1:], atol=1e-9)
    np.testing.assert_allclose(short.pose_covariance, joint.pose_covariance[6:, 6:], rtol=1e-5, atol=1e-13)
    kept = joint.hosted.host > 0
    np.testing.assert_allclose(short.hosted.uv_inverse_depth, joint.hosted.uv_inverse_depth[kept], atol=1e-8)


def test_an_adjusted_window_is_near_the_truth_within_its_covariance() -> None:
    window = filled(KEYFRAMES)
    window.adjust(5)
    truth = np.arange(KEYFRAMES)[:, None] * SIGHT
    sigma = np.sqrt(np.diag(window.pose_covariance).reshape(-1, 6))
    assert (np.abs(window.keyframes.positions - truth) < 4.0 * sigma[:, :3] + 1e-9).all()
    assert (np.diff(sigma[:, :3].max(axis=1)) > 0.0).all()  # drift: later poses are known less well
    assert sigma[-1, :3].max() < 0.01
    np.testing.assert_allclose(window.pose_covariance, window.pose_covariance.T, atol=1e-15)
    assert np.linalg.eigvalsh(window.pose_covariance).min() > 0.0
    np.testing.assert_array_equal(window.last_covariance, window.pose_covariance[-6:, -6:])


def test_the_first_pose_is_given() -> None:
    window = filled(KEYFRAMES)
    window.adjust(3)
    np.testing.assert_allclose(window.keyframes.positions[0], 0.0, atol=1e-6)
    np.testing.assert_allclose(np.sqrt(np.diag(window.pose_covariance)[:6]), 1e-5, rtol=0.01)


def test_the_oldest_keyframe_leaves_with_its_landmarks() -> None:
    window = filled(2)
    assert len(window) == 2
    np.testing.assert_array_equal(window.hosted.host, np.repeat([0, 1], PER_KEYFRAME))
    assert window.observations.uv.shape == (2 * PER_KEYFRAME, 2, 4)
    assert window.observations.variance.shape == (2 * PER_KEYFRAME, 2, 2, 3)
    landmarks = window.landmarks()
    expected = np.repeat([2.0, 3.0], PER_KEYFRAME)  # patches stay with their landmarks
    np.testing.assert_array_equal(landmarks.patches.level(0).values[:, 0, 1], expected)
    np.testing.assert_array_equal(
        landmarks.hosts.positions, window.keyframes.positions[[0, 1]].repeat(PER_KEYFRAME, axis=0)
    )


def test_covariance_goes_on_over_keyframes_that_left() -> None:
    sigmas = []
    for keyframes in range(2, 6):
        window = filled(2, keyframes=keyframes)
        window.adjust(2)
        sigmas.append(np.sqrt(np.trace(window.last_covariance[:3, :3])))
    assert all(later > earlier for earlier, later in pairwise(sigmas))


def test_inactive_landmarks_are_not_tracked_and_still_adjusted() -> None:
    window = filled(KEYFRAMES)
    gone = np.arange(5, 25)
    window.deactivate(gone)
    landmarks = window.landmarks()
    np.testing.assert_array_equal(landmarks.index, np.setdiff1d(np.arange(KEYFRAMES * PER_KEYFRAME), gone))
    assert len(landmarks.patches.level(0).values) == len(landmarks) == len(window.newest_observations)
    np.testing.assert_array_equal(landmarks.last_seen, window.observations.uv[landmarks.index, -1])
    before = window.hosted.uv_inverse_depth[gone]
    window.adjust(1)
    assert (window.hosted.uv_inverse_depth[gone] != before).any(axis=1).all()


def test_landmarks_are_points_of_the_world() -> None:
    window = filled(KEYFRAMES)
    landmarks = window.landmarks()
    for index in range(KEYFRAMES):
        hosted = window.hosted.host == index
        np.testing.assert_allclose(
            (landmarks.points[hosted] - window.keyframes.positions[index]) @ window.keyframes.rotations[index],
            landmarks.rays[hosted] / landmarks.inverse_depth[hosted, None],
            atol=1e-9,
        )


@pytest.mark.parametrize("columns", [0.05, -0.3])
def test_shifting_right_observations_and_back(columns: float) -> None:
    window = filled(KEYFRAMES)
    before = window.observations
    window.shift_right_observations(columns)
    x = (before.uv[..., 2] - CAMERA.cx) / CAMERA.fx
    np.testing.assert_allclose(window.observations.uv[..., 2] - before.uv[..., 2], columns * (1.0 + x * x), atol=1e-9)
    np.testing.assert_array_equal(window.observations.uv[..., (0, 1, 3)], before.uv[..., (0, 1, 3)])
    window.shift_right_observations(-columns)
    np.testing.assert_allclose(window.observations.uv, before.uv, atol=2.0 * columns**2 / CAMERA.fx)


def test_a_window_shows_the_shift_of_its_right_observations() -> None:
    offsets = []
    for columns in (0.0, 0.4):
        window = filled(KEYFRAMES)
        window.shift_right_observations(columns)
        window.adjust(8)
        offsets.append(window.right_offset[0])
    assert 0.5 * 0.4 < offsets[1] - offsets[0] < 1.2 * 0.4


def test_observations_do_not_change_in_place() -> None:
    one = Observations(np.zeros((0, 0, 4)), np.zeros((0, 0, 2, 3))).with_keyframe(
        np.zeros(0, np.intp), np.zeros((0, 4)), np.zeros((0, 2, 3))
    )
    two = one.with_landmarks(np.full((2, 4), 5.0), np.ones((2, 2, 3)))
    three = two.with_keyframe(np.array([1]), np.full((1, 4), 7.0), np.ones((1, 2, 3)))
    assert one.uv.shape == (0, 1, 4)
    assert (two.uv == 5.0).all()
    assert np.isnan(three.uv[0, 1]).all()
    assert (three.uv[1, 1] == 7.0).all()
    assert (three.without_oldest(np.array([False, True])).uv == 7.0).all()
