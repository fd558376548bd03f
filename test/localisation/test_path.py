"""Initial guesses of the next pose, and what is added to the covariance of a pose in its window."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from sfr_loc_map.geometry.camera import Pose
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform, propagated_covariance
from sfr_loc_map.localisation.backend.online_calibration import (
    FIRST_SIGMA_PX,
    DriftEstimate,
    OnlineCalibration,
    YawEstimate,
)
from sfr_loc_map.localisation.config import MotionBounds
from sfr_loc_map.localisation.estimate import StartPose, StepEstimate
from sfr_loc_map.localisation.findings import Inflation
from sfr_loc_map.localisation.frontend.right_camera import NO_SHEAR
from sfr_loc_map.localisation.keyframes import KEYFRAME_FLOW_RATIO
from sfr_loc_map.localisation.motion_model import MAX_MISSED_PAIRS, Prediction
from sfr_loc_map.localisation.motion_size import MAX_ANGLE_RAD, MotionSize
from sfr_loc_map.localisation.path import PathState
from sfr_loc_map.localisation.uncertainty.error_sources import ErrorSources, RoverModel
from sfr_loc_map.localisation.uncertainty.pose_covariance import AcceptedPair, pose_terms

RIG = StereoRig(640, 480, 400.0, 400.0, 320.0, 240.0, 0.2, Transform.from_quat([0.3, 0.1, 0.2], [0.5, -0.5, 0.5, -0.5]))
IN_CAMERA = replace(RIG, T_rb_sb=RIG.T_sb_left.inverse())
"""A rig whose left camera is RB."""
SOURCES = ErrorSources()
TURN = Transform(matrix_from_rotvec([0.01, -0.02, 0.03]), np.array([0.05, 0.01, 0.2]))
PERIOD_NS = 100_000_000
DEPTH_M, PER_PX = 5.0, 5.0 / 80.0
"""Depth, m, and ratio by which a disparity error of one pixel scales a step: depth / (f b)."""
STEP, NOTHING = np.array([0.1, 0.0, 0.3]), np.zeros((6, 6))
LENGTH = np.linalg.norm(STEP)
ANGLE = SOURCES.blur_px / 400.0
IMAGE = np.diag(np.square([ANGLE * DEPTH_M] * 3 + [ANGLE] * 3))
"""Covariance of the error of a whole image: an angle, and that angle at the depth."""
UNKNOWN_PX = np.hypot(FIRST_SIGMA_PX, SOURCES.disparity_px)


def true_path(count: int) -> list[Transform]:
    poses = [Transform.identity()]
    for _ in range(count - 1):
        poses.append(poses[-1] @ TURN)
    return poses


def model_of(rig: StereoRig) -> RoverModel:
    return RoverModel.of(rig, MotionBounds(), KEYFRAME_FLOW_RATIO)


def map_of(covariance: np.ndarray) -> SimpleNamespace:
    """Return a map whose newest pose has a covariance in its window."""
    landmarks = SimpleNamespace(median_depth=DEPTH_M)
    return SimpleNamespace(landmarks=landmarks, covariance=covariance, last_motion=None)


def begun(rig: StereoRig = IN_CAMERA) -> PathState:
    model = model_of(rig)
    path = PathState.started(StartPose(Transform.identity()), model).arrived(0)
    return path.window_begun(0, map_of(NOTHING), model)[0]  # type: ignore[arg-type]


def pair_at(
    number: int,
    to: Transform | np.ndarray,
    inflation: Inflation = Inflation.NONE,
    known: OnlineCalibration | None = None,
    noise: float = 1e-18,
) -> AcceptedPair:
    """Return the pair of a number that was tracked at a pose, or a position."""
    return AcceptedPair(
        number * PERIOD_NS,
        to if isinstance(to, Transform) else Transform(np.eye(3), to),
        given_keyframes=noise * np.eye(6),
        tracked_depth_m=DEPTH_M,
        chi_median=1.0,
        landmark_map=map_of(NOTHING),  # type: ignore[arg-type]
        calibration=known or OnlineCalibration(RIG.camera, (RIG.height, RIG.width), 7),
        was_known=True,
        shear=NO_SHEAR,
        inflation=inflation,
        other_distance=MotionSize(0.0, 0.0),
    )


def accepted(path: PathState, pair: AcceptedPair, model: RoverModel) -> tuple[PathState, StepEstimate]:
    """Return the path after a pair arrived and its pose was accepted, and the step to it."""
    return path.arrived(pair.stamp_ns).accepted(pair, model)


def move(
    path: PathState,
    number: int,
    to: Transform | np.ndarray,
    known: OnlineCalibration | None = None,
    rig: StereoRig = IN_CAMERA,
    inflation: Inflation = Inflation.NONE,
) -> PathState:
    """Return the path after the pair of a number was tracked at a pose, or a position."""
    return accepted(path, pair_at(number, to, inflation, known), model_of(rig))[0]


def lost_until(path: PathState, number: int) -> PathState:
    """Return the path after all pairs up to that of a number arrived and were lost."""
    assert path.arrived_ns is not None
    for stamp_ns in range(path.arrived_ns + PERIOD_NS, (number + 1) * PERIOD_NS, PERIOD_NS):
        path = path.arrived(stamp_ns).lost()
    return path


def adjusted(path: PathState, to: np.ndarray) -> PathState:
    """Return the path after an adjustment moved the newest keyframe to a position."""
    landmark_map = SimpleNamespace(window=SimpleNamespace(newest_pose=Pose(np.eye(3), to)), covariance=NOTHING)
    return path.adjusted(landmark_map, model_of(IN_CAMERA), has_yaw_step=False)  # type: ignore[arg-type]


def step_to(path: PathState, number: int, to: np.ndarray) -> StepEstimate:
    """Return the step to the pair of a number that is tracked at a position."""
    return accepted(path, pair_at(number, to), model_of(IN_CAMERA))[1]


def of_path(path: PathState, known: OnlineCalibration | None = None) -> np.ndarray:
    """Return what the path adds to the covariance of the position."""
    position = path.last.T_world_left.translation
    calibration = known or OnlineCalibration(RIG.camera, (RIG.height, RIG.width), 7)
    terms = pose_terms(path.errors, position, calibration, model_of(IN_CAMERA))
    images = IMAGE + propagated_covariance(IMAGE, position)
    return np.asarray((terms.total - terms.correlated - images)[:3, :3])


def correlated_of(path: PathState) -> np.ndarray:
    """Return the covariance of the errors of a path that have one direction in all steps."""
    position = path.last.T_world_left.translation
    return pose_terms(
        path.errors, position, OnlineCalibration(RIG.camera, (RIG.height, RIG.width), 7), model_of(IN_CAMERA)
    ).correlated


def test_the_angle_of_repeated_ambiguity_is_at_most_that_of_an_unknown_attitude() -> None:
    path = begun()
    for number in range(1, 100):
        path = move(path, number, number * STEP, inflation=Inflation.AMBIGUITY)
    correlated = correlated_of(path)
    assert np.sqrt(correlated[3, 3]) == pytest.approx(MAX_ANGLE_RAD)


@pytest.mark.parametrize("is_late", [False, True])
def test_lens_distortion_bends_the_path_to_a_circle_whenever_a_pose_from_outside_is_applied(*, is_late: bool) -> None:
    path = move(begun(), 1, STEP)
    if not is_late:
        path = set_at(path, 1, 1)
    for number in range(2, 202):
        path = move(path, number, number * STEP)
    if is_late:
        path = set_at(path, 1, 201)
    length_m = 200 * LENGTH
    rad_per_m = SOURCES.lens_px / 80.0
    correlated = correlated_of(path)
    assert np.sqrt(correlated[3, 3]) == pytest.approx(rad_per_m * length_m, rel=1e-6)
    assert np.sqrt(correlated[1, 1]) == pytest.approx(rad_per_m * length_m**2 / 2.0, rel=0.01)


# ---- guesses


def predicted(path: PathState, stamp_ns: int, odometry: Transform | None = None) -> Prediction:
    """Return the prediction of the pair after a path."""
    return path.last.predict(stamp_ns, odometry, RIG.T_rb_left)


def guesses(stamp_ns: int, odometry: Transform | None = None) -> list[np.ndarray]:
    """Return the guesses of a path that has three poses one period apart."""
    path = begun(RIG)
    for number, pose in enumerate(true_path(3)[1:], 1):
        path = move(path, number, pose, rig=RIG)
    return [Transform(*guess).matrix for guess in predicted(path, stamp_ns, odometry).guesses]


@pytest.mark.parametrize("missed", [0, 1, MAX_MISSED_PAIRS, MAX_MISSED_PAIRS + 1])
def test_constant_velocity_then_standstill_then_as_many_missed_pairs_as_the_stamps_tell(missed: int) -> None:
    first, second, *further = guesses((3 + missed) * PERIOD_NS)
    np.testing.assert_allclose(first, true_path(4)[-1].matrix, atol=1e-12)
    np.testing.assert_array_equal(second, true_path(3)[-1].matrix)
    assert len(further) == (0 < missed <= MAX_MISSED_PAIRS)
    for guess in further:
        np.testing.assert_allclose(guess, true_path(4 + missed)[-1].matrix, atol=1e-12)


def test_the_motion_over_a_long_gap_is_repeated_as_the_mean_motion_of_one_period() -> None:
    poses = true_path(22)
    path = move(lost_until(move(begun(RIG), 1, poses[1], rig=RIG), 19), 20, poses[20], rig=RIG)
    prediction = predicted(path, 21 * PERIOD_NS)
    assert len(prediction.guesses) == 2
    repeated = Transform(*prediction.repeated_motion)
    moved = poses[20].inverse() @ repeated
    np.testing.assert_allclose(moved.rotation, TURN.rotation, atol=1e-12)
    assert np.linalg.norm(moved.translation - TURN.translation) < 0.3 * np.linalg.norm(TURN.translation)


def test_after_a_lost_pair_the_only_guesses_are_a_standstill_and_the_odometry() -> None:
    poses = true_path(3)
    path = move(begun(RIG), 1, poses[1], rig=RIG)
    lost = lost_until(path, 3)
    assert len(predicted(path, 4 * PERIOD_NS).guesses) == 3
    assert len(predicted(lost, 4 * PERIOD_NS).guesses) == 1
    assert len(predicted(lost, 4 * PERIOD_NS, TURN).guesses) == 2


def test_wheel_odometry_is_a_motion_of_the_rover() -> None:
    before, now = (pose @ RIG.T_rb_left.inverse() for pose in true_path(4)[2:])
    found = guesses(3 * PERIOD_NS, before.inverse() @ now)
    np.testing.assert_allclose(found[-1], true_path(4)[3].matrix, atol=1e-12)
    assert len(found) == 3


# ---- covariance


def test_yaw_error_grows_in_proportion_to_the_path_and_a_path_back_takes_it_back() -> None:
    path = begun()
    for count in range(1, 6):
        path = move(path, count, count * STEP)
        covariance = of_path(path)
        assert np.sqrt(np.trace(covariance)) == pytest.approx(count * UNKNOWN_PX * PER_PX * LENGTH)
        np.testing.assert_allclose(covariance @ np.array([0.3, 0.0, -0.1]), 0.0, atol=1e-12)  # along the path alone
    path = move(path, 6, 0.0 * STEP)
    np.testing.assert_allclose(of_path(path), 0.0, atol=1e-16)


def test_a_yaw_found_late_leaves_the_path_before_it_uncertain() -> None:
    exact = OnlineCalibration(RIG.camera, (RIG.height, RIG.width), 7, yaw=YawEstimate(0.5, 0.0, 0.5))
    common = SOURCES.disparity_px * PER_PX * LENGTH
    path = move(begun(), 1, STEP, exact)  # not corrected
    assert np.trace(of_path(path, exact)) == pytest.approx(
        (1.0 + SOURCES.unsettled_yaw_ratio**2) * (0.5 * PER_PX * LENGTH) ** 2 + common**2
    )
    corrected = exact._replace(yaw=exact.yaw._replace(corrected_px=0.5))
    path = move(path, 2, 2.0 * STEP, corrected)
    assert np.trace(of_path(path, corrected)) == pytest.approx((0.5 * PER_PX * LENGTH) ** 2 + (2 * common) ** 2)


def test_the_attitude_is_not_more_certain_after_its_calibration_was_discarded() -> None:
    """The corrected yaw has bent the path, even if a later adjustment diverges."""
    known = OnlineCalibration(
        RIG.camera, (RIG.height, RIG.width), 7, yaw=YawEstimate(2.0, 1e-4, 2.0, 2.0), drift=DriftEstimate(total_px=20.0)
    )
    path = move(move(begun(), 1, STEP, known), 2, 2.0 * STEP, known)
    position = path.last.T_world_left.translation
    calibrations = (known, known.diverged(), known.diverged().diverged())
    attitudes = [pose_terms(path.errors, position, each, model_of(IN_CAMERA)).attitude[5, 5] for each in calibrations]
    assert sorted(attitudes) == attitudes


def test_what_the_images_of_a_pose_may_not_show_lasts_until_the_next_pose() -> None:
    model = model_of(IN_CAMERA)
    clear = move(begun(), 1, STEP)
    inflated = move(begun(), 1, STEP, inflation=Inflation.UNOBSERVED)
    added = of_path(inflated) - of_path(clear)
    assert np.linalg.eigvalsh(added)[0] > 0.0
    now_ns = 2 * PERIOD_NS
    for path in (inflated, adjusted(inflated, STEP)):
        assert path is not None
        kept, of_kept = path.kept(now_ns, model)
        clear_kept, of_clear = clear.kept(now_ns, model)
        np.testing.assert_allclose(of_path(kept) - of_path(clear_kept), added)
        assert np.linalg.eigvalsh(of_path(kept) - of_path(path))[0] > 0.0
        np.testing.assert_array_equal(of_kept.covariance, of_clear.covariance)
        for number in (3, 4):  # a window that begins, even after further kept pairs
            again = kept.window_begun(number * PERIOD_NS, map_of(NOTHING), model)[0]  # type: ignore[arg-type]
            clear_again = clear.window_begun(number * PERIOD_NS, map_of(NOTHING), model)[0]  # type: ignore[arg-type]
            np.testing.assert_allclose(
                again.errors.before_window.covariance[:3, :3] - clear_again.errors.before_window.covariance[:3, :3],
                added,
            )
        np.testing.assert_allclose(of_path(move(kept, 3, STEP)), of_path(move(clear_kept, 3, STEP)), atol=1e-16)


def test_the_step_to_a_kept_pose_is_the_motion_of_the_pose_by_an_adjustment() -> None:
    model = model_of(IN_CAMERA)
    path = adjusted(move(begun(), 1, STEP), STEP + 0.001)
    assert path is not None
    kept, first = path.kept(2 * PERIOD_NS, model)
    np.testing.assert_allclose(first.motion, [0.001, 0.001, 0.001, 0.0, 0.0, 0.0], atol=1e-15)
    again = kept.kept(3 * PERIOD_NS, model)[1]
    np.testing.assert_array_equal(again.motion, np.zeros(6))


def test_a_caller_cannot_overwrite_the_zero_that_all_steps_and_poses_share() -> None:
    step = step_to(begun(), 1, STEP)
    with pytest.raises(ValueError, match="read-only"):
        step.speed_change[0, 0] = 1.0


@pytest.mark.parametrize("inflation", [Inflation.NONE, Inflation.UNOBSERVED, Inflation.AMBIGUITY])
def test_a_step_from_the_first_pair_of_a_window_does_not_contain_the_motion_before_the_window(
    inflation: Inflation,
) -> None:
    model = model_of(IN_CAMERA)
    before = accepted(begun(), pair_at(1, STEP, inflation, noise=1e-4), model)[0]
    assert np.trace(before.published.noise) > 0.0
    path = before.lost()
    path, gap = path.window_begun(51 * PERIOD_NS, map_of(NOTHING), model)  # type: ignore[arg-type]
    step = step_to(path, 52, 1.1 * STEP)
    of_first_step = step_to(begun(), 1, 0.1 * STEP)
    assert np.sqrt(gap.covariance[0, 0]) == pytest.approx(5.0 * LENGTH / 0.1)  # 5 s at the last speed
    np.testing.assert_allclose(step.covariance, of_first_step.covariance, atol=1e-9)
    np.testing.assert_array_equal(step.noise_before, of_first_step.noise_before)


def test_an_unobserved_motion_is_at_most_as_fast_as_the_rover() -> None:
    """Two pairs 0.1 ms apart show 2 cm: 200 m/s."""
    bounds = MotionBounds(max_speed_m_s=2.0)
    model = RoverModel.of(IN_CAMERA, bounds, KEYFRAME_FLOW_RATIO)
    pair = pair_at(1, 0.02 * STEP / LENGTH)._replace(stamp_ns=100_000)
    path = accepted(begun(), pair, model)[0]
    gap = path.kept(100_000 + PERIOD_NS, model)[1]
    assert np.sqrt(gap.covariance[0, 0]) == pytest.approx(0.1 * bounds.max_speed_m_s)


def test_a_step_from_a_kept_pose_contains_the_motion_while_the_pose_was_kept() -> None:
    kept, gap = move(begun(), 1, STEP).kept(2 * PERIOD_NS, model_of(IN_CAMERA))
    step = step_to(kept, 3, 3.0 * STEP)
    assert np.linalg.eigvalsh(step.covariance - gap.covariance)[0] > -1e-9


def placed_in_the_window_before(start_variance: float) -> tuple[PathState, PathState]:
    """Return a path of two windows before and after an exact pose from outside that is of the earlier window."""
    model = model_of(IN_CAMERA)
    start = StartPose(Transform.identity(), start_variance * np.eye(6))
    path = PathState.started(start, model).arrived(0)
    path = path.window_begun(0, map_of(NOTHING), model)[0]  # type: ignore[arg-type]
    path = move(move(path, 1, STEP), 2, 2.0 * STEP)
    path = path.window_begun(12 * PERIOD_NS, map_of(NOTHING), model)[0]  # type: ignore[arg-type]
    path = move(path, 13, 3.0 * STEP)
    exact = StartPose(Transform(np.eye(3), STEP), NOTHING, PERIOD_NS)
    given = path.pose_set(exact, model)
    return path, given.pose_applied(13 * PERIOD_NS, model)[0]


def test_an_exact_pose_from_outside_of_an_earlier_window_replaces_the_start_and_keeps_the_gap() -> None:
    before, after = placed_in_the_window_before(100.0)
    exact = placed_in_the_window_before(0.0)[1]
    assert np.trace(of_path(before)) > 300.0
    np.testing.assert_allclose(of_path(after), of_path(exact), atol=1e-9)
    gap = before.errors.before_window.covariance[:3, :3]
    assert np.trace(gap) > 1.0  # ten pairs without an image
    assert np.trace(of_path(after)) == pytest.approx(np.trace(gap), rel=0.05)
    assert np.linalg.eigvalsh(of_path(after))[0] >= 0.0


@pytest.mark.parametrize("stamps", [(30, 35), (30, 30), (35, 30)])
def test_the_second_of_two_late_poses_replaces_the_first_and_the_covariance_stays_valid(
    stamps: tuple[int, int],
) -> None:
    """Both poses are applied after the drive went on, and the correlated errors count from the second pose alone."""
    model = model_of(IN_CAMERA)
    path = begun()
    for number in range(1, 41):
        path = move(path, number, number * STEP)
    first, second = (StartPose(Transform(np.eye(3), at * STEP), NOTHING, at * PERIOD_NS) for at in stamps)
    twice = once = path
    twice = twice.pose_set(first, model).pose_applied(40 * PERIOD_NS, model)[0]
    for number in range(41, 43):
        twice = move(twice, number, number * STEP)
        once = move(once, number, number * STEP)
    twice = twice.pose_set(second, model).pose_applied(42 * PERIOD_NS, model)[0]
    once = once.pose_set(second, model).pose_applied(42 * PERIOD_NS, model)[0]
    for number in range(43, 80):
        inflation = Inflation.AMBIGUITY if number == 60 else Inflation.NONE
        twice = move(twice, number, number * STEP, inflation=inflation)
        once = move(once, number, number * STEP, inflation=inflation)
        correlated = correlated_of(twice)
        np.testing.assert_allclose(correlated, correlated_of(once), rtol=1e-9, atol=1e-15)
        assert np.linalg.eigvalsh(correlated)[0] > -1e-15
        travelled_m = (number - stamps[1]) * LENGTH
        sigma_rad = SOURCES.lens_px / 80.0 * travelled_m
        if number < 60:
            assert np.sqrt(correlated[3, 3]) == pytest.approx(sigma_rad, rel=0.2)


def test_a_pose_from_outside_while_a_pose_is_kept_leaves_the_motion_since_its_stamp_uncertain() -> None:
    model = model_of(IN_CAMERA)
    path = move(begun(), 1, STEP).kept(11 * PERIOD_NS, model)[0]
    exact = StartPose(Transform(np.eye(3), STEP), NOTHING, 3 * PERIOD_NS)
    path, is_map_forgotten = path.pose_set(exact, model).pose_applied(11 * PERIOD_NS, model)
    assert is_map_forgotten
    at_pair = path.errors.kept_motion
    expected = np.square(LENGTH / 0.1 * 0.8)  # the rover may have continued at its last speed
    assert model.bounds.unseen_speed_m_s < LENGTH / 0.1
    np.testing.assert_allclose(at_pair[[0, 1], [0, 1]], expected, rtol=1e-6)
    later = path.kept(12 * PERIOD_NS, model)[0].errors.kept_motion
    assert np.linalg.eigvalsh(later - at_pair)[0] >= 0.0
    without_stamp = path.pose_set(StartPose(Transform(np.eye(3), STEP), NOTHING), model)
    at_next = without_stamp.pose_applied(12 * PERIOD_NS, model)[0]
    np.testing.assert_array_equal(at_next.errors.kept_motion, NOTHING)


@pytest.mark.parametrize("kept_until", [3, 4])
def test_an_exact_external_pose_at_a_kept_pair_is_exact_there_and_its_motion_counts_once(kept_until: int) -> None:
    """The map is kept after one kept pair, and discarded after two."""
    model = model_of(IN_CAMERA)
    path = move(move(begun(), 1, STEP), 2, 2.0 * STEP)
    for number in range(3, kept_until + 1):
        path = path.arrived(number * PERIOD_NS).kept(number * PERIOD_NS, model)[0]
    path = set_at(path, kept_until, kept_until)
    position = path.last.T_world_left.translation
    terms = pose_terms(path.errors, position, OnlineCalibration(RIG.camera, (RIG.height, RIG.width), 7), model)
    np.testing.assert_array_equal(terms.total[:3, :3], np.zeros((3, 3)))
    unobserved = np.square(LENGTH)  # the rover may have continued at its last speed for one period
    again = path.kept((kept_until + 1) * PERIOD_NS, model)[0]
    np.testing.assert_allclose(again.errors.kept_motion[0, 0], unobserved, rtol=1e-6)
    if kept_until == 3:
        accepted_next = move(again, 5, 5.0 * STEP)
        assert 1.0 <= of_path(accepted_next)[0, 0] / unobserved < 1.5


@pytest.mark.parametrize("jitter_ns", [0, 1, 1_000_000])
def test_jitter_of_the_stamps_does_not_decide_whether_a_pose_from_outside_discards_the_map(jitter_ns: int) -> None:
    model = model_of(IN_CAMERA)
    path = move(move(begun(), 1, STEP), 2, 2.0 * STEP)
    kept_ns = 3 * PERIOD_NS + jitter_ns
    path = path.arrived(kept_ns).kept(kept_ns, model)[0]
    path = path.pose_set(StartPose(Transform(np.eye(3), 3.0 * STEP), NOTHING, kept_ns), model)
    assert not path.pose_applied(kept_ns, model)[1]


@pytest.mark.parametrize("are_missing", [False, True])
def test_a_gap_before_the_last_pair_does_not_let_a_much_later_pose_from_outside_keep_the_map(
    *, are_missing: bool
) -> None:
    model = model_of(IN_CAMERA)
    path = move(begun(), 1, STEP)
    path = move(path if are_missing else lost_until(path, 99), 100, 2.0 * STEP)
    path = lost_until(path, 240)
    exact = StartPose(Transform(np.eye(3), 3.0 * STEP), NOTHING, 240 * PERIOD_NS)
    assert path.pose_set(exact, model).pose_applied(240 * PERIOD_NS, model)[1]


@pytest.mark.parametrize("kept_pairs", [range(3, 33), ()])
def test_a_pose_from_outside_between_two_pairs_far_apart_contains_the_motion_to_the_nearer_pair(
    kept_pairs: Sequence[int],
) -> None:
    """Between the pairs, images are repeated or missing. The rover moved at the beginning, and stopped."""
    model = model_of(IN_CAMERA)
    ahead = np.array([0.3, 0.0, 0.0])
    path = move(move(begun(), 1, ahead), 2, 2.0 * ahead)
    for number in kept_pairs:
        path = path.kept(number * PERIOD_NS, model)[0]
    path = move(path, 33, 3.0 * ahead)
    exact = StartPose(Transform(np.eye(3), 3.0 * ahead), NOTHING, 9 * PERIOD_NS)
    path = path.pose_set(exact, model).pose_applied(33 * PERIOD_NS, model)[0]
    error = (path.datum.T_ds_world @ path.last.T_world_left).translation - 3.0 * ahead
    assert error[0] > 0.06
    assert of_path(path)[0, 0] > error[0] ** 2


@pytest.mark.parametrize(
    ("before", "at", "is_gap"),
    [
        ([], 100, True),
        ([], 6, True),
        ([], 5, False),
        ([], 1, False),
        ([1], 100, True),
        ([1], 3, True),
        ([1, 2], 3, False),
        ([1, 100], 120, True),
        ([100], 120, True),
        ([100], 101, False),
        ([100], 200, False),
    ],
)
def test_a_pose_between_two_pairs_contains_the_unobserved_motion_of_a_gap(
    before: list[int], at: int, *, is_gap: bool
) -> None:
    """The pairs are of one window, which begins at pair 0. The number of the pair after the external pose is `at`."""
    path = begun()
    for number in (*before, at):
        path = move(path, number, STEP)
    previous = ([0, *before])[-1]
    half_ns = (previous + at) * PERIOD_NS // 2
    model = model_of(IN_CAMERA)
    exact = StartPose(Transform(np.eye(3), STEP), NOTHING, half_ns)
    path = path.pose_set(exact, model).pose_applied(at * PERIOD_NS, model)[0]
    unobserved = ((at - previous) / 2 * PERIOD_NS / 1e9 * model.bounds.unseen_speed_m_s) ** 2
    assert (of_path(path)[0, 0] >= 0.9 * unobserved) == is_gap


def set_at(path: PathState, number: int, now: int) -> PathState:
    """Return the path after an exact external pose was applied to the pair of a number, at a later pair."""
    model = model_of(IN_CAMERA)
    exact = StartPose(Transform(np.eye(3), number * STEP), NOTHING, number * PERIOD_NS)
    return path.pose_set(exact, model).pose_applied(now * PERIOD_NS, model)[0]


@pytest.mark.parametrize("now", [2, 3])
def test_a_pose_from_outside_for_a_pair_with_stale_parts_leaves_the_motion_to_this_pair_uncertain(now: int) -> None:
    """The wrong pose of that pair moves the whole map, whether a later pair came before the external pose or not."""
    path = move(begun(), 1, STEP)
    torn = move(path, 2, 2.0 * STEP, inflation=Inflation.UNOBSERVED)
    clean = move(path, 2, 2.0 * STEP)
    if now == 3:
        torn, clean = (move(path, 3, 3.0 * STEP) for path in (torn, clean))
    torn, clean = (set_at(path, 2, now) for path in (torn, clean))
    later = [of_path(move(path, 4, 4.0 * STEP)) for path in (torn, clean)]
    unobserved = (PERIOD_NS / 1e9 * model_of(IN_CAMERA).bounds.unseen_speed_m_s) ** 2
    assert later[0][0, 0] - later[1][0, 0] >= unobserved


def test_a_pose_set_at_the_present_pair_has_no_errors_of_the_image() -> None:
    path = set_at(move(move(begun(), 1, STEP), 2, 2.0 * STEP), 2, 2)
    np.testing.assert_array_equal(path.errors.this_pair, NOTHING)
    assert np.trace(move(path, 3, 3.0 * STEP).errors.this_pair) > 0.0


def test_a_pose_from_outside_for_the_pair_of_a_keyframe_applies_to_its_adjusted_pose() -> None:
    """A correction of the yaw moves the keyframe by 5 mm, and the next pair is tracked from there."""
    moved = STEP + np.array([0.005, 0.0, 0.0])
    path = adjusted(move(begun(), 1, STEP), moved)
    path = set_at(move(path, 2, moved + STEP), 1, 2)
    present = (path.datum.T_ds_world @ path.last.T_world_left).translation
    np.testing.assert_allclose(present, 2.0 * STEP, atol=1e-12)


@pytest.mark.parametrize("is_new_window", [False, True])
def test_the_noise_of_two_images_is_added_between_a_pose_from_outside_and_the_present_pose(
    *, is_new_window: bool
) -> None:
    """A window that begins in between adds the noise of the pose at which it begins."""
    model = model_of(IN_CAMERA)
    noise = 0.01**2

    def covariance_with(noise: float) -> np.ndarray:
        path = accepted(begun(), pair_at(1, STEP, noise=noise), model)[0]
        path = accepted(path, pair_at(2, 2.0 * STEP, noise=noise), model)[0]
        if is_new_window:
            path = path.window_begun(3 * PERIOD_NS, map_of(NOTHING), model)[0]  # type: ignore[arg-type]
        path = accepted(path, pair_at(4, 3.0 * STEP, noise=noise), model)[0]
        return of_path(set_at(path, 1, 4))

    added = covariance_with(noise) - covariance_with(1e-18)
    images = 3.0 if is_new_window else 2.0
    assert np.linalg.eigvalsh(added)[0] >= 0.999 * images * noise * SOURCES.adjustment_inflation


@pytest.mark.parametrize("at", [1, 2, 4])
def test_drift_corrections_before_a_pose_from_outside_leave_its_attitude_certain(at: int) -> None:
    """The external pose is for an earlier pair, for the last pair, or later than the last pair."""
    model = model_of(IN_CAMERA)
    followed = OnlineCalibration(RIG.camera, (RIG.height, RIG.width), 7, drift=DriftEstimate(total_px=20.0))

    def attitude(path: PathState, known: OnlineCalibration) -> float:
        position = path.last.T_world_left.translation
        return float(pose_terms(path.errors, position, known, model).total[3, 3])

    path = move(move(begun(), 1, STEP, followed), 2, 2.0 * STEP, followed)
    before = attitude(path, followed)
    path = set_at(path, at, max(at, 2))
    after = attitude(path, followed)
    per_px2 = (SOURCES.drift_attitude_ratio / RIG.fx) ** 2
    assert before - after > 0.9 * per_px2 * 20.0**2
    further = followed._replace(drift=DriftEstimate(total_px=30.0))
    path = move(path, 5, 3.0 * STEP, further)
    assert attitude(path, further) - after == pytest.approx(per_px2 * 10.0**2, rel=0.05)


def test_the_terms_of_a_straight_path_are_those_of_the_example() -> None:
    """The example in the docstring of `uncertainty`: 10 m ahead, with a yaw that is known to 0.02 px."""
    rig = StereoRig(640, 480, 500.0, 500.0, 320.0, 240.0, 0.2, Transform.identity())
    rig = replace(rig, T_rb_sb=rig.T_sb_left.inverse())
    known = OnlineCalibration(rig.camera, (rig.height, rig.width), 7, yaw=YawEstimate(0.0, 0.02**2))
    path = begun(rig)
    for number in range(1, 101):
        path = move(path, number, np.array([0.1 * number, 0.0, 0.0]), known, rig)
    terms = pose_terms(path.errors, path.last.T_world_left.translation, known, model_of(rig))
    sigmas = {name: np.sqrt(np.diag(term)) for name, term in terms._asdict().items()}
    assert sigmas["this_pair"][[0, 3]] == pytest.approx([3.0e-4, 60e-6], rel=0.01)
    assert sigmas["correlated"][[1, 5]] == pytest.approx([3.5e-4, 70e-6], rel=0.02)
    assert sigmas["disparity"][:2] == pytest.approx([0.0112, 0.0], rel=0.01)
    assert sigmas["attitude"][3] == pytest.approx(10e-6)


@pytest.mark.parametrize("fraction", [0.25, 0.8])
def test_a_pose_between_two_consecutive_pairs_is_interpolated_in_proportion(fraction: float) -> None:
    path = move(move(begun(), 1, STEP), 2, 2.0 * STEP)
    found = path.pose_at(round((1.0 + fraction) * PERIOD_NS), model_of(IN_CAMERA))
    assert found is not None
    np.testing.assert_allclose(found.translation, (1.0 + fraction) * STEP, atol=1e-12)
