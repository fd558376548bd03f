import numpy as np

from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.estimate import (
    PoseEstimate,
    StateReason,
    TrackingState,
    TrackingStatistics,
    lost_covariance,
)


def test_figures_are_those_that_the_call_has_with_its_stage_times() -> None:
    assert TrackingStatistics().as_dict() == {}
    statistics = TrackingStatistics(features=7, residual_px=0.5, disparity_offset_px=-0.0)
    found = PoseEstimate(5, Transform.identity(), np.eye(6), TrackingState.TRACKING, statistics, {"align": 0.25})
    assert found.figures == {"features": 7.0, "residual_px": 0.5, "disparity_offset_px": 0.0, "stage_align_s": 0.25}
    assert all(type(value) is float for value in found.figures.values())
    assert found.reason_text == ""


def test_a_lost_pose_has_a_variance_of_9999_and_a_reason_in_a_word() -> None:
    np.testing.assert_array_equal(lost_covariance(), 9999.0 * np.eye(6))
    lost = PoseEstimate(
        5, Transform.identity(), lost_covariance(), TrackingState.LOST, reason=StateReason.UNSEEN_MOTION
    )
    assert lost.reason_text == "unseen_motion"
