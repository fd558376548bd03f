"""Initial guesses of the next pose, and what is added to the covariance of a pose in its window."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from sfr_loc_map.geometry.camera import Pose
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform, propagated_covariance
from sfr_loc_map.localisation.backend.online_calibration import FIRST_SIGMA_PX, OnlineCalibration
from sfr_loc_map.localisation.config import MotionBounds
from sfr_loc_map.localisation.estimate import StartPose, StepEstimate
from sfr_loc_map.localisation.pose_track import (
    COMMON_DISPARITY_PX,
    COMMON_PX,
    MAX_MISSED_PAIRS,
    UNSETTLED_SHARE,
    PoseTrack,
)

RIG = StereoRig(640, 480, 400.0, 400.0, 320.0, 240.0, 0.2, Transform.from_quat([0.3, 0.1, 0.2], [0.5, -0.5, 0.5, -0.5]))
IN_CAMERA = replace(RIG, T_rb_sb=RIG.T_sb_left.inverse())
"""A rig whose left camera is RB."""
TURN = Transform(matrix_from_rotvec([0.01, -0.02, 0.03]), np.array([0.05, 0.01, 0.2]))
PERIOD_NS = 100_000_000
DEPTH_M, PER_PX = 5.0, 5.0 / 80.0
"""Depth, metres, and its share by which a disparity error of one pixel scales a step: depth / (f b)."""
STEP, NOTHING = np.array([0.1, 0.0, 0.3]), np.zeros((6, 6))
LENGTH = np.linalg.norm(STEP)
ANGLE = COMMON_PX / 400.0
IMAGE = np.diag(np.square([ANGLE * DEPTH_M] * 3 + [ANGLE] * 3))
"""Covariance of an error of a whole image: an angle, and that angle at the depth."""
UNKNOWN_PX = np.hypot(FIRST_SIGMA_PX, COMMON_DISPARITY_PX)


def path(count: int) -> list[Transform]:
    poses = [Transform.identity()]
    for _ in range(count - 1):
        poses.append(poses[-1] @ TURN)
    return poses


def begun(rig: StereoRig = IN_CAMERA) -> PoseTrack:
    track = PoseTrack(rig, MotionBounds(), StartPose(Transform.identity()))
    track.arrive(0)
    track.begin(0, NOTHING, DEPTH_M)
    return track


def move(
    track: PoseTrack,
    number: int,
    to: Transform | np.ndarray,
    in_window: np.ndarray = NOTHING,
    known: OnlineCalibration | None = None,
) -> StepEstimate | None:
    """Let the pair of a number be tracked at a pose, or a position, that is known so well in its window."""
    pose = Pose(to.rotation, to.translation) if isinstance(to, Transform) else Pose(np.eye(3), to)
    result = SimpleNamespace(pose=pose, information=1e18 * np.eye(6), landmarks=SimpleNamespace(median_depth=DEPTH_M))
    window, known = SimpleNamespace(covariance=in_window, drift=None), known or OnlineCalibration(RIG.camera, 7)
    return track.moved(number * PERIOD_NS, result, window, DEPTH_M, known, 1.0, follows=True, doubt=None)  # type: ignore[arg-type]


def of_path(track: PoseTrack, known: OnlineCalibration | None = None) -> np.ndarray:
    """Return what the path adds to the covariance of the position."""
    covariance = (
        track.covariance_of_left(DEPTH_M, known or OnlineCalibration(RIG.camera, 7)) - track._doubted.covariance
    )
    images = IMAGE + propagated_covariance(IMAGE, track.T_world_left.translation)
    return np.asarray((covariance - images)[:3, :3])


# ---- guesses


def guesses(stamp_ns: int, motion: Transform | None = None) -> list[np.ndarray]:
    """Return the guesses of a track that has seen three poses one period apart."""
    track = begun(RIG)
    for number, pose in enumerate(path(3)[1:], 1):
        assert move(track, number, pose) is not None
    return [Transform(*guess).matrix for guess in track.guesses(stamp_ns, motion)]


@pytest.mark.parametrize("missed", [0, 1, MAX_MISSED_PAIRS, MAX_MISSED_PAIRS + 1])
def test_constant_velocity_then_standstill_then_as_many_missed_pairs_as_the_stamps_tell(missed: int) -> None:
    first, second, *further = guesses((3 + missed) * PERIOD_NS)
    np.testing.assert_allclose(first, path(4)[-1].matrix, atol=1e-12)
    np.testing.assert_array_equal(second, path(3)[-1].matrix)
    assert len(further) == (0 < missed <= MAX_MISSED_PAIRS)
    for guess in further:
        np.testing.assert_allclose(guess, path(4 + missed)[-1].matrix, atol=1e-12)


def test_wheel_odometry_is_a_motion_of_the_rover() -> None:
    before, now = (pose @ RIG.T_rb_left.inverse() for pose in path(4)[2:])
    found = guesses(3 * PERIOD_NS, before.inverse() @ now)
    np.testing.assert_allclose(found[-1], path(4)[3].matrix, atol=1e-12)
    assert len(found) == 3


# ---- covariance


def test_yaw_error_grows_in_proportion_to_the_path_and_a_path_back_takes_it_back() -> None:
    track = begun()
    for count in range(1, 6):
        move(track, count, count * STEP)
        covariance = of_path(track)
        assert np.sqrt(np.trace(covariance)) == pytest.approx(count * UNKNOWN_PX * PER_PX * LENGTH)
        np.testing.assert_allclose(covariance @ np.array([0.3, 0.0, -0.1]), 0.0, atol=1e-12)  # along the path alone
    move(track, 6, 0.0 * STEP)
    np.testing.assert_allclose(of_path(track), 0.0, atol=1e-16)


def test_a_yaw_found_late_leaves_the_path_before_it_uncertain() -> None:
    track, known = begun(), OnlineCalibration(RIG.camera, 7)
    known.target_u, known.sigma_u = 0.5, 0.0
    common = COMMON_DISPARITY_PX * PER_PX * LENGTH
    move(track, 1, STEP, known=known)  # not corrected
    assert np.trace(of_path(track, known)) == pytest.approx(
        (1.0 + UNSETTLED_SHARE**2) * (0.5 * PER_PX * LENGTH) ** 2 + common**2
    )
    known.constant_u = 0.5
    move(track, 2, 2.0 * STEP, known=known)
    assert np.trace(of_path(track, known)) == pytest.approx((0.5 * PER_PX * LENGTH) ** 2 + (2 * common) ** 2)
