"""Tracking of landmarks: offset of the right camera, trust, variance."""

from __future__ import annotations

import numpy as np
import pytest
from loc_drive import frame_of, pair_of_drive
from made_scene import LOC_RIG

from sfr_loc_map.geometry.camera import Pose
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.frontend import tracking
from sfr_loc_map.localisation.frontend.landmarks import Landmarks
from sfr_loc_map.localisation.frontend.pose_solver import PoseSolution, RightOffset
from sfr_loc_map.localisation.frontend.tracking import PIXEL_FLOOR, StereoFrame, Tracker
from sfr_loc_map.localisation.keyframe_backend import KeyframeBackend

CAMERA, STRAIGHT, STILL = LOC_RIG.camera, RightOffset(), Pose(np.eye(3), np.zeros(3))
TRACKER = Tracker(LocalisationConfig(min_tracked=20), CAMERA)


def frame(index: int) -> StereoFrame:
    return frame_of(pair_of_drive(index))


@pytest.fixture(scope="module")
def landmarks() -> Landmarks:
    """Landmarks of the first pair, whose left camera is the world."""
    backend = KeyframeBackend(LOC_RIG, LocalisationConfig(), TRACKER)
    backend.begin(frame(0), Transform.identity())
    return backend.landmarks


def test_the_offset_of_the_right_camera_is_subtracted(landmarks: Landmarks) -> None:
    straight, shifted = (TRACKER.refine(frame(0), landmarks, STILL, RightOffset(u=u)) for u in (0.0, 0.1))
    difference = straight.observations - shifted.observations
    np.testing.assert_array_equal(difference[np.isfinite(difference[:, 0]), :2], 0.0)
    right = straight.observations[:, 2:]
    seen = np.isfinite(right[:, 0])
    np.testing.assert_allclose(difference[seen, 2:], RightOffset(u=0.1).at(right[seen], CAMERA), atol=1e-12)


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
    landmarks: Landmarks, monkeypatch: pytest.MonkeyPatch, inliers: int, outliers: int, missing: int, trusted: bool
) -> None:
    chi2 = np.repeat([1.0, 50.0, np.nan], [inliers, outliers, missing])
    monkeypatch.setattr(tracking, "solve_pose", lambda *_: PoseSolution(STILL, np.eye(6), chi2))
    found = TRACKER.refine(frame(0), landmarks.subset(np.arange(len(landmarks.index)) < len(chi2)), STILL, STRAIGHT)
    assert found.trusted is trusted
    assert found.inlier_count == inliers


def test_a_noisy_patch_gives_a_variance_in_proportion_and_one_below_the_median_does_not() -> None:
    covariance, residual = np.tile([4e-4, 1e-4, 2e-4], (5, 1)), np.array([1.0, 2.0, 4.0, 8.0, np.nan])
    variance = TRACKER.position_variance(covariance, residual)
    floor = PIXEL_FLOOR**2 * np.array([1.0, 0.0, 1.0])
    for row, level in enumerate((3.0, 3.0, 4.0, 8.0)):
        np.testing.assert_allclose(variance[row], 1.2 * level**2 * covariance[row] + floor)
    assert np.isnan(variance[4]).all()
    # with small pixels a track counts by its residual over the median
    fine = Tracker(LocalisationConfig(), CAMERA._replace(fx=800.0, fy=800.0))
    variance = fine.position_variance(np.zeros((5, 3)), np.array([0.1, 1.0, 2.0, 9.0, np.nan]))
    np.testing.assert_allclose(variance[:4, 0], PIXEL_FLOOR**2 * np.array([0.5, 1 / 1.5, 2 / 1.5, 4.0]) ** 4)
