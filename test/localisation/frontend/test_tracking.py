"""Tracking of landmarks: coarse and fine pose, trust, swapped images."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from loc_drive import BLACK, pair_of_drive
from made_scene import LOC_RIG, true_pose

from sfr_loc_map.geometry.camera import Pose
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.frontend.landmarks import Landmarks
from sfr_loc_map.localisation.frontend.right_offset import RightOffset
from sfr_loc_map.localisation.frontend.tracking import StereoFrame, Tracker, TrackingResult
from sfr_loc_map.localisation.keyframe_backend import KeyframeBackend

CONFIG = LocalisationConfig(min_tracked=20)
CAMERA = LOC_RIG.camera
STRAIGHT = RightOffset()


def frame(index: int) -> StereoFrame:
    return StereoFrame.of(pair_of_drive(index))


def camera_motion(index: int) -> Transform:
    """Return the left camera at a pair in that of the first pair."""
    first, now = (true_pose(k) @ LOC_RIG.T_rb_left for k in (0, index))
    return first.inverse() @ now


@pytest.fixture(scope="module")
def tracker() -> Tracker:
    return Tracker(CONFIG, CAMERA)


@pytest.fixture(scope="module")
def landmarks(tracker: Tracker) -> Landmarks:
    """Landmarks of the first pair, whose left camera is the world."""
    backend = KeyframeBackend(LOC_RIG, CONFIG, CAMERA, tracker)
    backend.begin(frame(0), Transform.identity())
    return backend.landmarks


@pytest.fixture(scope="module")
def result(tracker: Tracker, landmarks: Landmarks) -> TrackingResult:
    start = Pose.of(camera_motion(3))
    return tracker.refine(frame(3), landmarks, start, STRAIGHT)


def as_if(result: TrackingResult, inliers: int, outliers: int, missing: int) -> TrackingResult:
    """Return a result with so many of each kind."""
    count = inliers + outliers + missing
    chi2 = np.repeat([1.0, 50.0, np.nan], [inliers, outliers, missing])
    rows = np.resize(np.arange(len(result.landmarks)), count)
    parts = {name: getattr(result, name)[rows] for name in ("observations", "variance")}
    landmarks = replace(result.landmarks, index=result.landmarks.index[rows])
    return replace(result, landmarks=landmarks, chi2_per_dof=chi2, **parts)


@pytest.mark.parametrize("index", [1, 4, 8])
def test_coarse_and_fine_pose_from_standstill(tracker: Tracker, landmarks: Landmarks, index: int) -> None:
    coarse = tracker.align(frame(index).left, landmarks, [Transform.identity()])
    fine = tracker.refine(frame(index), landmarks, coarse, STRAIGHT)
    truth = camera_motion(index)
    assert np.linalg.norm(coarse.position - truth.translation) < 0.01
    assert tracker.trusts(fine)
    assert np.linalg.norm(fine.pose.position - truth.translation) < 0.002
    np.testing.assert_allclose(fine.T_world_left.rotation, truth.rotation, atol=1e-3)


def test_the_guess_that_fits_the_image_best_is_taken(tracker: Tracker, landmarks: Landmarks) -> None:
    wrong = Transform(matrix_from_rotvec([0.0, 0.5, 0.0]), np.array([0.5, 0.0, 0.3]))
    truth = camera_motion(8)
    alone = tracker.align(frame(8).left, landmarks, [truth])
    for guesses in ([wrong, truth], [truth, wrong]):
        found = tracker.align(frame(8).left, landmarks, guesses)
        np.testing.assert_array_equal(found.position, alone.position)


def test_a_start_off_by_some_pixels_is_refined_from_afar(tracker: Tracker, landmarks: Landmarks) -> None:
    truth = camera_motion(3)
    rotation = matrix_from_rotvec([0.0, 0.02, 0.0]) @ truth.rotation  # 3 px
    found = tracker.refine_from_afar(frame(3), landmarks, Pose(rotation, truth.translation), STRAIGHT)
    assert tracker.trusts(found)
    np.testing.assert_allclose(found.pose.position, truth.translation, atol=0.002)


def test_uncertainty_of_the_pose_and_residuals_are_of_a_size(result: TrackingResult) -> None:
    sigma = np.sqrt(np.diag(np.linalg.inv(result.information)))
    assert 1e-5 < sigma[:3].min() < sigma[:3].max() < 0.01
    assert result.inliers.mean() > 0.8
    assert 0.0 < result.residual_px < 0.5
    assert result.right_share > 0.9
    assert result.left_inlier_count <= result.inliers.sum()


def test_flow_is_measured_from_the_keyframe_to_the_image(result: TrackingResult) -> None:
    points = camera_motion(3).inverse().apply(result.landmarks.points)
    seen = points[:, :2] / points[:, 2:] * [CAMERA.fx, CAMERA.fy] + [CAMERA.cx, CAMERA.cy]
    expected = np.linalg.norm(seen - result.landmarks.last_seen[:, :2], axis=1)
    assert np.median(result.flow_px) == pytest.approx(np.nanmedian(expected), abs=0.3)


def test_the_offset_of_the_right_camera_is_subtracted(tracker: Tracker, landmarks: Landmarks) -> None:
    start = Pose(np.eye(3), np.zeros(3))
    straight, shifted = (tracker.refine(frame(0), landmarks, start, RightOffset(u=u)) for u in (0.0, 0.1))
    difference = straight.observations - shifted.observations
    np.testing.assert_array_equal(difference[np.isfinite(difference[:, 0]), :2], 0.0)
    right = straight.observations[:, 2:]
    known = np.isfinite(right[:, 0])
    expected = RightOffset(u=0.1).at(right[known], CAMERA)
    np.testing.assert_allclose(difference[known, 2:], expected, atol=1e-12)


@pytest.mark.parametrize(
    ("inliers", "outliers", "missing", "trusted"),
    [
        (20, 0, 0, True),
        (19, 0, 0, False),  # fewer than min_tracked
        (30, 29, 0, True),
        (30, 30, 0, False),  # no more than half of those found
        (20, 0, 79, True),
        (20, 0, 80, False),  # no more than a fifth of all
    ],
)
def test_trust(
    tracker: Tracker, result: TrackingResult, inliers: int, outliers: int, missing: int, trusted: bool
) -> None:
    assert tracker.trusts(as_if(result, inliers, outliers, missing)) is trusted


def test_swapped_images_are_seen(tracker: Tracker, landmarks: Landmarks, result: TrackingResult) -> None:
    start = Pose.of(camera_motion(3))
    straight = frame(3)
    swapped = straight._replace(left=straight.right, right=straight.left)
    # the pose that fits the right image taken for a left one
    shifted = Pose(start.rotation, start.position + start.rotation[:, 0] * LOC_RIG.baseline_m)
    found = tracker.refine(swapped, landmarks, shifted, STRAIGHT)
    assert tracker.left_right_swapped(swapped, found, STRAIGHT)
    assert not tracker.left_right_swapped(straight, result, STRAIGHT)
    black = StereoFrame.of(StereoPair(0, BLACK, BLACK))
    assert not tracker.left_right_swapped(straight._replace(right=black.right), found, STRAIGHT)


def test_a_noisy_patch_gives_a_variance_in_proportion_and_one_below_the_median_does_not(tracker: Tracker) -> None:
    covariance = np.tile([4e-4, 1e-4, 2e-4], (5, 1))
    residual = np.array([1.0, 2.0, 4.0, 8.0, np.nan])
    variance = tracker.position_variance(covariance, residual)
    floor = CONFIG.pixel_floor**2 * np.array([1.0, 0.0, 1.0])
    for row, level in enumerate((3.0, 3.0, 4.0, 8.0)):
        np.testing.assert_allclose(variance[row], 1.2 * level**2 * covariance[row] + floor)
    assert np.isnan(variance[4]).all()


def test_with_small_pixels_a_track_counts_by_its_residual() -> None:
    fine = Tracker(CONFIG, CAMERA._replace(fx=800.0, fy=800.0))
    variance = fine.position_variance(np.zeros((5, 3)), np.array([0.1, 1.0, 2.0, 9.0, np.nan]))
    typical = 1.5  # the median
    expected = CONFIG.pixel_floor**2 * np.array([0.5, 1.0 / typical, 2.0 / typical, 4.0]) ** 4
    np.testing.assert_allclose(variance[:4, 0], expected)
    np.testing.assert_allclose(variance[:4, 2], expected)
