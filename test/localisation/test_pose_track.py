"""Initial guesses of the next pose."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_scene import LOC_RIG

from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.config import MotionBounds
from sfr_loc_map.localisation.estimate import StartPose
from sfr_loc_map.localisation.pose_track import MAX_MISSED_PAIRS, PoseTrack

T_RB_SB = Transform.from_quat([0.3, 0.1, 0.2], [0.5, -0.5, 0.5, -0.5])
RIG = replace(LOC_RIG, T_rb_sb=T_RB_SB)
STEP = Transform(matrix_from_rotvec([0.01, -0.02, 0.03]), np.array([0.05, 0.01, 0.2]))
PERIOD_NS = 100_000_000


def path(count: int) -> list[Transform]:
    poses = [Transform.identity()]
    for _ in range(count - 1):
        poses.append(poses[-1] @ STEP)
    return poses


def move(track: PoseTrack, stamp_ns: int, pose: Transform) -> None:
    mark = track.covariance.follow(pose.translation, STEP.translation, np.eye(6), 3.0, 0.0)
    track.moved(stamp_ns, pose, mark, follows=True)


@pytest.fixture
def driven() -> PoseTrack:
    """A track that has seen three poses one period apart."""
    track = PoseTrack(RIG, MotionBounds(), StartPose(Transform.identity()))
    track.arrive(0)
    track.begin(0, track.covariance.start(np.zeros(3), np.eye(6), np.eye(6), 3.0))
    for index, pose in enumerate(path(3)[1:], 1):
        move(track, index * PERIOD_NS, pose)
    return track


def guesses(track: PoseTrack, stamp_ns: int, motion: Transform | None = None) -> list[np.ndarray]:
    return [Transform(*guess).matrix for guess in track.guesses(stamp_ns, motion)]


def test_constant_velocity_first_then_standstill(driven: PoseTrack) -> None:
    first, second = guesses(driven, 3 * PERIOD_NS)
    np.testing.assert_allclose(first, path(4)[-1].matrix, atol=1e-12)
    np.testing.assert_array_equal(second, path(3)[-1].matrix)


@pytest.mark.parametrize("missed", [1, MAX_MISSED_PAIRS])
def test_missed_pairs_are_counted_by_the_stamps(driven: PoseTrack, missed: int) -> None:
    found = guesses(driven, (3 + missed) * PERIOD_NS)
    assert len(found) == 3
    np.testing.assert_allclose(found[2], path(4 + missed)[-1].matrix, atol=1e-12)


@pytest.mark.parametrize("stamp_ns", [3 * PERIOD_NS, round(3.4 * PERIOD_NS), (4 + MAX_MISSED_PAIRS) * PERIOD_NS, 0])
def test_no_extrapolation_over_no_pair_nor_over_too_many(driven: PoseTrack, stamp_ns: int) -> None:
    assert len(guesses(driven, stamp_ns)) == 2


def test_wheel_odometry_is_a_motion_of_the_rover(driven: PoseTrack) -> None:
    before, now = (pose @ RIG.T_rb_left.inverse() for pose in path(4)[2:])
    found = guesses(driven, 3 * PERIOD_NS, before.inverse() @ now)
    np.testing.assert_allclose(found[-1], path(4)[3].matrix, atol=1e-12)
    assert len(found) == 3


def test_a_stopped_track_predicts_rest_and_a_new_window_does_not_know_the_period(driven: PoseTrack) -> None:
    driven.stop()
    for guess in guesses(driven, 5 * PERIOD_NS):
        np.testing.assert_array_equal(guess, path(3)[-1].matrix)
    move(driven, 5 * PERIOD_NS, path(4)[-1])
    assert len(guesses(driven, 8 * PERIOD_NS)) == 2  # that is the period now
    assert len(guesses(driven, 11 * PERIOD_NS)) == 3
    driven.begin(10 * PERIOD_NS, driven.covariance.start(np.zeros(3), np.eye(6), np.eye(6), 3.0))
    assert len(guesses(driven, 13 * PERIOD_NS)) == 2


def test_no_rover_leaps_and_no_pose_is_infinite(driven: PoseTrack) -> None:
    last = path(3)[-1]
    at = np.array([10.0, 0.0, 0.0])
    for shift, fits in ((0.0, True), (10.0, False), (np.nan, False)):
        pose = driven.guesses(3 * PERIOD_NS, None)[1]._replace(position=last.translation + shift)
        assert (driven.plausible(3 * PERIOD_NS, pose) is not None) is fits
    assert driven.plausible(10 * PERIOD_NS, driven.guesses(0, None)[1]._replace(position=at)) is not None  # 50 m/s
