from dataclasses import FrozenInstanceError

import numpy as np
import pytest

from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.estimate import (
    PoseEstimate,
    StateReason,
    TrackingState,
    TrackingStatistics,
    lost_covariance,
)


def estimate(**parts: object) -> PoseEstimate:
    return PoseEstimate(5, Transform.identity(), np.eye(6), TrackingState.TRACKING, **parts)


def test_only_the_figures_of_the_call_are_given_as_numbers() -> None:
    assert TrackingStatistics().as_dict() == {}
    found = TrackingStatistics(features=7, residual_px=float("nan"), disparity_offset_px=-0.0).as_dict()
    assert list(found) == ["features", "residual_px", "disparity_offset_px"]
    assert all(type(value) is float for value in found.values())


def test_figures_join_statistics_and_stage_times() -> None:
    found = estimate(statistics=TrackingStatistics(inliers=3), stage_s={"align": 0.25}).figures
    assert found == {"inliers": 3.0, "stage_align_s": 0.25}


def test_stage_times_are_a_copy_and_read_only() -> None:
    timed = {"wait": 0.1}
    result = estimate(stage_s=timed)
    timed["keyframe"] = 9.0
    assert dict(result.stage_s) == {"wait": 0.1}
    with pytest.raises(TypeError):
        result.stage_s["wait"] = 0.0
    with pytest.raises(FrozenInstanceError):
        result.stamp_ns = 6


def test_a_lost_pose_has_a_variance_of_9999() -> None:
    np.testing.assert_array_equal(lost_covariance(), 9999.0 * np.eye(6))


def test_a_state_gives_its_reason_in_a_word() -> None:
    assert estimate().reason_text == ""
    assert estimate(reason=StateReason.UNSEEN_MOTION).reason_text == "unseen_motion"
