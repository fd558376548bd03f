"""What the steps from one published pose to the next contain, by the events between them."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.backend.online_calibration import OnlineCalibration
from sfr_loc_map.localisation.config import MotionBounds
from sfr_loc_map.localisation.findings import Inflation
from sfr_loc_map.localisation.frontend.right_camera import NO_SHEAR
from sfr_loc_map.localisation.keyframes import KEYFRAME_FLOW_RATIO
from sfr_loc_map.localisation.motion_size import NO_MOTION, MotionSize, Speed
from sfr_loc_map.localisation.uncertainty.error_sources import (
    ZERO,
    AddedError,
    RoverModel,
    inflation_of,
    unobserved_size,
)
from sfr_loc_map.localisation.uncertainty.pose_covariance import AcceptedPair
from sfr_loc_map.localisation.uncertainty.step_covariance import MIN_VARIANCE, PublishedPose

RIG = StereoRig(640, 480, 400.0, 400.0, 320.0, 240.0, 0.2, Transform.identity())
MODEL = RoverModel.of(replace(RIG, T_rb_sb=RIG.T_sb_left.inverse()), MotionBounds(), KEYFRAME_FLOW_RATIO)
PERIOD_NS = 100_000_000
SPEED = Speed(0.3, 0.0)
NO_ERROR = AddedError(ZERO, NO_MOTION)


def pair(number: int, *, was_known: bool = True) -> AcceptedPair:
    """Return the pair of a number, at a position of 0.03 m times this number."""
    depth_m = 5.0
    landmark_map: Any = SimpleNamespace(landmarks=SimpleNamespace(median_depth=depth_m), last_motion=None)
    return AcceptedPair(
        stamp_ns=number * PERIOD_NS,
        T_world_left=Transform(np.eye(3), np.array([0.03 * number, 0.0, 0.0])),
        given_keyframes=np.eye(6) * 1e-18,
        tracked_depth_m=depth_m,
        chi_median=1.0,
        landmark_map=landmark_map,
        calibration=OnlineCalibration(RIG.camera, (480, 640), 7),
        was_known=was_known,
        shear=NO_SHEAR,
        inflation=Inflation.NONE,
        other_distance=MotionSize(0.0, 0.0),
    )


def added(inflation: Inflation, *, distance_m: float = 0.0) -> AddedError:
    """Return what findings add for one period at the speed of the tests."""
    return inflation_of(
        inflation,
        unobserved=unobserved_size(SPEED, 0.1, MODEL.bounds),
        moved=MotionSize(0.03, 0.0),
        other_distance=MotionSize(distance_m, 0.0),
        sources=MODEL.sources,
    )


@pytest.mark.parametrize(
    ("error", "metres", "radians"),
    [
        (NO_ERROR, 0.0, 0.0),
        (added(Inflation.UNOBSERVED), 0.1, 0.05),
        (added(Inflation.AMBIGUITY, distance_m=0.04), 0.1, 0.05),
        (added(Inflation.AMBIGUITY, distance_m=0.4), 0.4, 0.05),
        (added(Inflation.AMBIGUITY | Inflation.UNOBSERVED), np.sqrt(2.0) * 0.1, np.sqrt(2.0) * 0.05),
    ],
)
def test_an_added_error_is_part_of_the_steps_to_and_from_its_pose(
    error: AddedError, metres: float, radians: float
) -> None:
    """The examples in the docstring of `uncertainty`."""
    first, _ = PublishedPose().accepted(pair(1), SPEED, NO_ERROR, MODEL)
    wrong, step_to = first.accepted(pair(2), SPEED, error, MODEL)
    after, step_from = wrong.accepted(pair(3), SPEED, NO_ERROR, MODEL)
    _, step_later = after.accepted(pair(4), SPEED, NO_ERROR, MODEL)
    for step in (step_to, step_from):
        np.testing.assert_allclose(np.sqrt(step.covariance[[0, 5], [0, 5]]), [metres, radians], atol=1e-3)
    np.testing.assert_allclose(np.sqrt(step_later.covariance[0, 0]), 0.0, atol=1e-3)


def test_the_steps_to_kept_poses_add_up_to_the_unobserved_motion() -> None:
    published, _ = PublishedPose().accepted(pair(1), SPEED, NO_ERROR, MODEL)
    here = published.T_world_left
    assert here is not None
    variance = 0.0
    for count in (1, 2, 3):
        stamp_ns = (1 + count) * PERIOD_NS
        published, step = published.kept(stamp_ns, here, unobserved_s=0.1 * count, speed=SPEED, model=MODEL)
        variance += step.covariance[0, 0] - MIN_VARIANCE
        assert np.sqrt(variance) == pytest.approx(0.1 * count)
        np.testing.assert_array_equal(step.motion, np.zeros(6))
    _, step = published.accepted(pair(5), SPEED, NO_ERROR, MODEL)
    assert np.sqrt(step.covariance[0, 0]) == pytest.approx(0.3, rel=1e-3)  # the rover may have moved back


def test_a_step_after_a_lost_pair_contains_a_change_of_speed() -> None:
    published, _ = PublishedPose().accepted(pair(1), SPEED, NO_ERROR, MODEL)
    _, known = published.accepted(pair(3), SPEED, NO_ERROR, MODEL)
    _, unknown = published.accepted(pair(3, was_known=False), SPEED, NO_ERROR, MODEL)
    np.testing.assert_array_equal(known.speed_change, ZERO)
    assert np.sqrt(unknown.speed_change[0, 0]) == pytest.approx(0.2)  # 1 m/s for 0.2 s
    assert unknown.seconds == pytest.approx(0.2)


def test_a_window_ends_the_errors_of_earlier_poses() -> None:
    wrong, _ = PublishedPose().accepted(pair(1), SPEED, added(Inflation.UNOBSERVED), MODEL)
    _, step = wrong.window_begun().accepted(pair(2), SPEED, NO_ERROR, MODEL)
    np.testing.assert_allclose(np.sqrt(step.covariance[0, 0]), 0.0, atol=1e-3)
    np.testing.assert_array_equal(step.noise_before, ZERO)


def test_a_correction_of_the_yaw_is_part_of_the_next_step() -> None:
    published, _ = PublishedPose().accepted(pair(1), SPEED, NO_ERROR, MODEL)
    _, step = published.adjusted(MotionSize(0.02, 0.001)).accepted(pair(2), SPEED, NO_ERROR, MODEL)
    np.testing.assert_allclose(np.sqrt(step.covariance[[0, 3], [0, 3]]), [0.02, 0.001], rtol=1e-2)
