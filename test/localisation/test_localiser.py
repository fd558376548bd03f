"""The localiser in a small world that is known exactly: a rover before a textured wall, with good and bad images."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import fields, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from helpers import made_scene
from helpers.loc_drive import BLACK, LOST, KeyframesAtOnce, black, drive, errors, localiser, noisy, run
from helpers.made_scene import HEIGHT, LOC_RIG, PERIOD_NS, START_NS, T_RB_LOCSB, WIDTH, stereo_pair, true_pose
from sfr_loc_map.errors import ConfigError, GeometryError, LocalisationError
from sfr_loc_map.geometry.camera import Pose
from sfr_loc_map.geometry.rotation import rotvec_from_matrix
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.geometry.transform import Transform, interpolated, propagated_covariance
from sfr_loc_map.localisation.backend.online_calibration import OnlineCalibration
from sfr_loc_map.localisation.config import TRACKED_LANDMARKS, LocalisationConfig
from sfr_loc_map.localisation.estimate import MAX_GIVEN_M, PoseEstimate, StartPose, StateReason, TrackingState
from sfr_loc_map.localisation.frontend.stereo_frame import StereoFrame
from sfr_loc_map.localisation.frontend.tracking import Tracker, Tracks
from sfr_loc_map.localisation.ground.memory import DYNAMIC_LIFE, GroundMemory
from sfr_loc_map.localisation.ground.rigid_motion import Exclusion
from sfr_loc_map.localisation.ground.selection import Ground
from sfr_loc_map.localisation.guards import ShearMean
from sfr_loc_map.localisation.keyframes import KeyframeMaker, KeyframeResult
from sfr_loc_map.localisation.localiser import Localiser
from sfr_loc_map.localisation.state import Candidate

DRIVE = drive()


def sigma(estimate: PoseEstimate) -> float:
    return float(np.sqrt(np.trace(estimate.covariance[:3, :3])))


def first_window(pair: StereoPair, config: LocalisationConfig) -> KeyframeResult:
    """Return a window that begins with a pair at the origin of the world."""
    calibration = OnlineCalibration(LOC_RIG.camera, (HEIGHT, WIDTH), config.window_keyframes)
    maker = KeyframeMaker(LOC_RIG, config)
    return maker.begin_window(StereoFrame.of(pair), Pose.of(Transform.identity()), calibration, None)


@pytest.fixture(scope="module")
def estimates() -> list[PoseEstimate]:
    return run(DRIVE)


@pytest.mark.clause("1.3")
def test_the_first_pose_is_the_one_given_and_all_are_near_the_truth(estimates: list[PoseEstimate]) -> None:
    """About 1 m of driving at 3 m from the wall; what is left comes from images rounded to whole grey levels."""
    np.testing.assert_allclose(estimates[0].T_ds_rb.matrix, true_pose(0).matrix, atol=1e-12)
    assert [estimate.stamp_ns for estimate in estimates] == [pair.stamp_ns for pair in DRIVE]
    assert [e.state for e in estimates] == [TrackingState.INITIALISING] + [TrackingState.TRACKING] * 39
    for index, estimate in enumerate(estimates[1:], start=1):
        metres, degrees = errors(estimate, true_pose(index))
        assert metres < min(0.003, 4 * sigma(estimate)), index
        assert degrees < 0.06, index
        np.testing.assert_array_equal(estimate.covariance, estimate.covariance.T)
        assert np.linalg.eigvalsh(estimate.covariance).min() > 0
    # a wall alone says little of the right camera's yaw, by which the path may be off
    assert sigma(estimates[2]) < sigma(estimates[-1]) < 0.02


def test_bits_depend_neither_on_how_fast_pairs_come_nor_on_a_drive_before(estimates: list[PoseEstimate]) -> None:
    """Keyframe work goes on between the calls: it ends early, late, or beside that of another localiser."""
    by, beside = localiser(), localiser()
    run(DRIVE[5:9], by)
    by.reset(true_pose(0))
    for index, pair in enumerate(DRIVE):
        found, wanted = by.process(pair), estimates[index]
        beside.process(replace(DRIVE[-1 - index], stamp_ns=pair.stamp_ns))
        time.sleep(0.03 * (index % 3))
        assert found.T_ds_rb.matrix.tobytes() == wanted.T_ds_rb.matrix.tobytes()
        assert found.covariance.tobytes() == wanted.covariance.tobytes()
        assert repr((found.state, found.statistics)) == repr((wanted.state, wanted.statistics))  # NaN equals itself


def test_a_caller_may_overwrite_what_was_given_and_returned(estimates: list[PoseEstimate]) -> None:
    start = StartPose(true_pose(0), np.zeros((6, 6)))
    T_ds_rb = Transform(start.T_ds_rb.rotation.copy(), start.T_ds_rb.translation.copy())
    covariance = np.zeros((6, 6))
    extrinsics = Transform(T_RB_LOCSB.rotation.copy(), T_RB_LOCSB.translation.copy())
    of_caller = Localiser(replace(LOC_RIG, T_rb_sb=extrinsics), start=StartPose(T_ds_rb, covariance))
    images = [np.empty_like(DRIVE[0].left), np.empty_like(DRIVE[0].right)]
    for given in (T_ds_rb.rotation, T_ds_rb.translation, covariance, extrinsics.rotation, extrinsics.translation):
        given[:] = 7.0
    for pair, expected in zip(DRIVE[:15], estimates, strict=False):
        images[0][:] = pair.left
        images[1][:] = pair.right
        found = of_caller.process(StereoPair(pair.stamp_ns, *images))
        np.testing.assert_array_equal(found.T_ds_rb.matrix, expected.T_ds_rb.matrix)
        np.testing.assert_array_equal(found.covariance, expected.covariance)
        assert found.step is not None
        assert expected.step is not None
        np.testing.assert_array_equal(found.step.motion_covariance, expected.step.motion_covariance)
        step_values = [getattr(found.step, item.name) for item in fields(found.step)]
        tracks = found.tracks or ()
        for array in (
            *images,
            *tracks,
            found.T_ds_rb.rotation,
            found.T_ds_rb.translation,
            found.covariance,
            *step_values,
        ):
            if isinstance(array, np.ndarray) and array.flags.writeable:
                array[:] = 7


@pytest.mark.parametrize("wrong", [3, None, "x"])
def test_an_argument_of_another_type_is_refused(wrong: Any) -> None:
    started = localiser()
    calls: list[tuple[type[Exception], Callable[[], object]]] = [
        (GeometryError, lambda: Localiser(wrong)),
        (GeometryError, lambda: Localiser(LOC_RIG, start=wrong)),
        (GeometryError, lambda: started.set_pose(wrong)),
        (GeometryError, lambda: started.reset(StartPose(wrong))),
        (LocalisationError, lambda: started.process(wrong)),
    ]
    if wrong is not None:
        calls.append((GeometryError, lambda: started.process(DRIVE[0], wrong)))
    for error, call in calls:
        with pytest.raises(error, match=f"has the type {type(wrong).__name__}"):
            call()
    assert started.process(DRIVE[0]).state is TrackingState.INITIALISING


@pytest.mark.parametrize(("width", "height"), [(2, 100), (100, 2), (15, 100), (100, 15), (16, 16), (17, 100)])
def test_small_images_are_refused_or_processed(width: int, height: int) -> None:
    rig = replace(LOC_RIG, width=width, height=height, fx=100.0, fy=100.0, cx=width / 2, cy=height / 2)
    if min(width, height) < 16:
        with pytest.raises(GeometryError, match="at least 16 x 16 px"):
            Localiser(rig)
        return
    images = np.random.default_rng(0).integers(0, 255, (2, height, width), dtype=np.uint8)
    assert Localiser(rig).process(StereoPair(0, *images)).state is TrackingState.LOST


@pytest.mark.parametrize("at", [2, 5])
def test_the_pose_at_a_past_stamp_is_that_of_its_pair_or_in_between(estimates: list[PoseEstimate], at: int) -> None:
    of_drive = localiser()
    assert of_drive.pose_at(START_NS) is None
    for pair in DRIVE[:6]:
        of_drive.process(pair)
    at_pair = of_drive.pose_at(DRIVE[at].stamp_ns)
    halfway = of_drive.pose_at(DRIVE[at].stamp_ns - PERIOD_NS // 2)
    assert at_pair is not None
    assert halfway is not None
    np.testing.assert_allclose(at_pair.matrix, estimates[at].T_ds_rb.matrix, atol=1e-3)
    mean = (estimates[at].T_ds_rb.translation + estimates[at - 1].T_ds_rb.translation) / 2
    np.testing.assert_allclose(halfway.translation, mean, atol=1e-3)


@pytest.mark.clause("3.2.4")
def test_covariance_is_that_of_the_rover_wherever_its_camera_is() -> None:
    """Two points fixed to the rover: the covariance of one follows from that of the other."""
    T_rb_other = Transform.from_quat([2.0, -1.0, 0.5], [0.0, 0.0, 0.0, 1.0])
    other = replace(LOC_RIG, T_rb_sb=T_rb_other.inverse() @ T_RB_LOCSB)
    start = true_pose(0) @ T_rb_other
    rover, point = run(DRIVE[:9])[-1], run(DRIVE[:9], Localiser(other, LocalisationConfig(), start))[-1]
    lever = point.T_ds_rb.translation - rover.T_ds_rb.translation
    assert np.linalg.norm(lever) > 2.0
    np.testing.assert_allclose(point.covariance, propagated_covariance(rover.covariance, lever), rtol=1e-6, atol=1e-14)


def test_what_does_not_fit_is_refused_and_changes_nothing(estimates: list[PoseEstimate]) -> None:
    by = localiser()
    run(DRIVE[:3], by)
    wide = np.zeros((HEIGHT, WIDTH + 1), np.uint8)
    with pytest.raises(LocalisationError, match="161 x 120"):
        by.process(StereoPair(DRIVE[3].stamp_ns, wide, wide))
    for earlier in DRIVE[1:3]:
        with pytest.raises(LocalisationError, match=str(DRIVE[2].stamp_ns)):
            by.process(earlier)
    assert by.process(DRIVE[3]).T_ds_rb.matrix.tobytes() == estimates[3].T_ds_rb.matrix.tobytes()
    exact = Transform.identity()
    for wrong in (
        *(
            StartPose(exact, covariance)
            for covariance in (np.full((6, 6), np.nan), -np.eye(6), np.ones(6), 1j * np.eye(6))
        ),
        *(StartPose(exact, stamp_ns=0.5), Transform(2.0 * np.eye(3), np.zeros(3))),
        *(Transform(np.eye(3), np.array([x, 0.0, 0.0])) for x in (1e9, -1.01 * MAX_GIVEN_M)),
    ):
        with pytest.raises(GeometryError, match="the external pose"):
            by.set_pose(wrong)
    for wrong in (Transform(3.0 * np.eye(3), np.zeros(3)), Transform(np.eye(3), np.full(3, 1e9))):
        with pytest.raises(GeometryError, match="odometry"):
            by.process(DRIVE[4], wrong)
    with pytest.raises(GeometryError, match="start pose"):
        by.reset(Transform(2.0 * np.eye(3), np.zeros(3)))
    assert by.process(DRIVE[4]).T_ds_rb.matrix.tobytes() == estimates[4].T_ds_rb.matrix.tobytes()
    with pytest.raises(ConfigError, match="max_features"):
        Localiser(LOC_RIG, LocalisationConfig(max_features=-5))
    with pytest.raises(ConfigError, match="min_tracked"):
        Localiser(LOC_RIG, LocalisationConfig(min_tracked=TRACKED_LANDMARKS + 1))
    with pytest.raises(GeometryError, match="T_rb_locsb"):
        Localiser(replace(LOC_RIG, T_rb_sb=None), LocalisationConfig(), Transform.identity())


def test_stamps_that_are_integers_of_numpy_do_not_overflow() -> None:
    by = Localiser(LOC_RIG, start=StartPose(true_pose(0), stamp_ns=np.int32(1)))  # type: ignore[arg-type]
    stamps = [np.int32(2), np.uint64(PERIOD_NS), np.int64(2 * PERIOD_NS)]
    found = [by.process(replace(pair, stamp_ns=stamp)) for pair, stamp in zip(DRIVE, stamps, strict=False)]
    by.set_pose(StartPose(true_pose(1), stamp_ns=np.uint64(PERIOD_NS)))  # type: ignore[arg-type]
    found.append(by.process(replace(DRIVE[3], stamp_ns=3 * PERIOD_NS)))
    assert [estimate.state.value for estimate in found] == ["initialising"] + 3 * ["tracking"]
    assert {type(estimate.stamp_ns) for estimate in found} == {int}


def test_a_start_pose_as_far_as_allowed_can_be_processed() -> None:
    far = Transform(np.eye(3), np.full(3, -MAX_GIVEN_M))
    by = localiser(far)
    run(DRIVE[:2], by)
    by.set_pose(far)
    estimate = by.process(DRIVE[2], Transform(np.eye(3), np.full(3, MAX_GIVEN_M)))
    np.testing.assert_allclose(estimate.T_ds_rb.translation, far.translation)


@pytest.mark.parametrize("side", ["left_mask", "right_mask"])
def test_masked_parts_have_no_landmarks(side: str, tmp_path: Path) -> None:
    mask, path = np.full((HEIGHT, WIDTH), 255, np.uint8), str(tmp_path / "mask.png")
    mask[:, : WIDTH // 2] = 0
    cv2.imwrite(path, mask)
    config = LocalisationConfig(**{side: path}, min_tracked=8)  # type: ignore[arg-type]
    landmarks = first_window(DRIVE[0], config).landmark_map.landmarks
    column = landmarks.last_seen[:, 0 if side == "left_mask" else 2]
    assert len(column) > 20
    assert column.min() > WIDTH // 2 - 1
    cv2.imwrite(path, mask[:3, :4])
    with pytest.raises(ConfigError, match=rf"4 x 3 pixels; give a greyscale .* of {WIDTH} x {HEIGHT} pixels"):
        Localiser(LOC_RIG, config, true_pose(0))


def test_steps_are_the_motions_between_the_poses(estimates: list[PoseEstimate]) -> None:
    for before, now in pairwise(estimates):
        step, moved = now.step, before.T_ds_rb.inverse() @ now.T_ds_rb
        assert step is not None
        assert step.seconds == pytest.approx(PERIOD_NS * 1e-9)
        np.testing.assert_allclose(step.motion[:3], moved.translation, atol=1e-9)
        np.testing.assert_allclose(step.motion[3:], rotvec_from_matrix(moved.rotation), atol=1e-9)
        assert np.linalg.eigvalsh(step.covariance).min() > 0.0


def test_steps_say_what_was_not_seen() -> None:
    again = [replace(DRIVE[5], stamp_ns=DRIVE[index].stamp_ns) for index in (6, 7)]
    steps = [estimate.step for estimate in run([*DRIVE[:6], *again, black(8), *DRIVE[9:11]])]
    first, repeated, lost, after, later = steps[0], steps[6:8], steps[8], steps[9], steps[10]
    assert lost is None
    assert first is not None
    assert first.seconds == 0.0
    assert after is not None
    assert later is not None
    np.testing.assert_allclose([step.motion for step in repeated if step], np.zeros((2, 6)), atol=1e-15)
    variance = sum(step.covariance[0, 0] for step in repeated if step)
    assert np.sqrt(variance) == pytest.approx(0.2, rel=0.2)  # 1 m/s over both together
    assert np.sqrt(after.covariance[0, 0]) == pytest.approx(0.2, rel=0.2)  # from a pose that was kept
    assert np.sqrt(later.covariance[0, 0]) < 0.02


# ---- poses from outside


def test_set_pose_is_where_the_next_estimate_starts(estimates: list[PoseEstimate]) -> None:
    T_set, by = Transform.from_quat([7.0, 8.0, 9.0], [0.0, 0.1, 0.7, 0.7]), localiser()
    by.set_pose(true_pose(20))
    np.testing.assert_allclose(by.process(DRIVE[0]).T_ds_rb.matrix, true_pose(20).matrix, atol=1e-12)
    run(DRIVE[1:10], by)
    by.set_pose(T_set)
    for index in range(10, 14):
        motion = estimates[10].T_ds_rb.inverse() @ estimates[index].T_ds_rb
        found = by.process(DRIVE[index])
        np.testing.assert_allclose(found.T_ds_rb.matrix, (T_set @ motion).matrix, atol=1e-9)
        assert found.state is TrackingState.TRACKING
    # a stamp far ahead is of another clock: it is taken for the next pair
    by.set_pose(StartPose(true_pose(20), stamp_ns=DRIVE[14].stamp_ns + 10**18))
    np.testing.assert_allclose(by.process(DRIVE[14]).T_ds_rb.matrix, true_pose(20).matrix, atol=1e-9)


@pytest.mark.parametrize(("ahead_ns", "state"), [(1, TrackingState.INITIALISING), (PERIOD_NS, TrackingState.DEGRADED)])
def test_a_start_pose_shortly_before_the_first_pair_leaves_no_gap(ahead_ns: int, state: TrackingState) -> None:
    by = Localiser(LOC_RIG, start=StartPose(true_pose(0), stamp_ns=DRIVE[0].stamp_ns - ahead_ns))
    assert by.process(DRIVE[0]).state is state


def test_a_start_pose_holds_at_its_stamp_however_late_the_truth_begins(estimates: list[PoseEstimate]) -> None:
    apart = [replace(pair, stamp_ns=START_NS + 11 * 10**9 * k) for k, pair in enumerate(DRIVE[:6])]
    for late_s, held in ((22, 2), (3600, 0)):  # of another clock: at the first pair
        by = Localiser(LOC_RIG, start=StartPose(true_pose(20), stamp_ns=START_NS + late_s * 10**9))
        found = run(apart, by)
        np.testing.assert_allclose(found[held].T_ds_rb.matrix, true_pose(20).matrix, atol=1e-9)


def test_a_pose_with_a_stamp_of_the_past_holds_there_with_its_covariance(estimates: list[PoseEstimate]) -> None:
    covariance = np.diag([0.04, 0.01, 0.0025, 1e-4, 1e-4, 4e-4])
    T_set, by = Transform.from_quat([7.0, 8.0, 9.0], [0.0, 0.1, 0.7, 0.7]), localiser()
    run(DRIVE[:10], by)
    by.set_pose(StartPose(T_set, covariance, DRIVE[4].stamp_ns))
    found = by.process(DRIVE[10])
    motion = estimates[4].T_ds_rb.inverse() @ estimates[10].T_ds_rb
    np.testing.assert_allclose(found.T_ds_rb.matrix, (T_set @ motion).matrix, atol=1e-9)
    swung = propagated_covariance(covariance, found.T_ds_rb.translation - T_set.translation)
    np.testing.assert_allclose(np.diag(found.covariance), np.diag(swung), rtol=0.02)


@pytest.mark.parametrize("stamped", [False, True])
def test_a_pose_set_while_lost_is_of_its_stamp_or_the_next_pair(*, stamped: bool) -> None:
    """It says nothing of the last known pose, which is of before the gap."""
    by = localiser()
    run([*DRIVE[:10], black(10)], by)
    pose, covariance = true_pose(11), 0.01**2 * np.eye(6)
    by.set_pose(StartPose(pose, covariance, DRIVE[11].stamp_ns if stamped else None))
    by.process(black(11))
    found = run(DRIVE[16:20], by)
    assert (found[0].state, found[0].reason) == (TrackingState.DEGRADED, StateReason.UNSEEN_MOTION)
    np.testing.assert_allclose(found[0].T_ds_rb.matrix, pose.matrix, atol=1e-9)
    for index, estimate in enumerate(found, 16):
        assert errors(estimate, true_pose(index))[0] < sigma(estimate)


@pytest.mark.parametrize("last", [0, 9])
def test_a_pose_set_before_a_repeated_pair_keeps_the_map_and_contains_the_motion_in_between(last: int) -> None:
    T_set, by = Transform.from_quat([7.0, 8.0, 9.0], [0.0, 0.1, 0.7, 0.7]), localiser()
    run(DRIVE[: last + 1], by)
    by.set_pose(T_set)
    repeated = by.process(replace(DRIVE[last], stamp_ns=DRIVE[last + 1].stamp_ns))
    np.testing.assert_allclose(repeated.T_ds_rb.matrix, T_set.matrix, atol=1e-9)
    for index, estimate in enumerate(run(DRIVE[last + 2 : last + 5], by), last + 2):
        assert estimate.state is TrackingState.TRACKING
        motion = true_pose(last + 1).inverse() @ true_pose(index)
        assert errors(estimate, T_set @ motion)[0] < 3.0 * sigma(estimate)


def test_a_pose_that_is_kept_is_never_less_certain_than_a_lost_one() -> None:
    by = localiser()
    run(DRIVE[:4], by)
    repeated = [replace(DRIVE[3], stamp_ns=DRIVE[3].stamp_ns + seconds * 10**9) for seconds in (90, 99, 101, 300)]
    found = run(repeated, by)
    assert [estimate.state for estimate in found] == [TrackingState.DEGRADED] * 2 + [TrackingState.LOST] * 2
    assert all((np.diag(estimate.covariance) <= np.diag(LOST)).all() for estimate in found)
    assert {estimate.reason for estimate in found} == {StateReason.REPEATED_IMAGES}
    again = replace(DRIVE[4], stamp_ns=repeated[-1].stamp_ns + PERIOD_NS)
    assert by.process(again).state is TrackingState.TRACKING


@pytest.mark.parametrize("late", [0.4, 1.0, 2.7])
def test_a_start_pose_of_a_later_stamp_than_the_first_pair_degrades_nothing(late: float) -> None:
    """A ground truth that begins after the images: the images show the motion up to the start pose."""
    before = int(late)
    pose = interpolated(true_pose(before), true_pose(before + 1), late - before)
    start = StartPose(pose, stamp_ns=START_NS + round(late * PERIOD_NS))
    found = run(DRIVE[:12], Localiser(LOC_RIG, LocalisationConfig(), start))
    assert {estimate.state for estimate in found} == {TrackingState.INITIALISING, TrackingState.TRACKING}
    for index in range(before + 1, 12):
        assert errors(found[index], true_pose(index))[0] < 0.003


# ---- images that show nothing, or nothing that is known


def test_a_black_first_pair_has_no_inliers() -> None:
    first = localiser().process(black(0))
    assert (first.state, first.statistics.inliers) == (TrackingState.LOST, 0)


@pytest.mark.parametrize("count", [1, 5, 15])
def test_black_images_are_lost_at_the_last_pose_and_recovered(count: int) -> None:
    by = localiser()
    last = run(DRIVE[:10], by)[-1]
    for index in range(10, 10 + count):
        estimate = by.process(black(index))
        assert estimate.state is TrackingState.LOST
        np.testing.assert_array_equal(estimate.covariance, LOST)
        assert estimate.T_ds_rb.matrix.tobytes() == last.T_ds_rb.matrix.tobytes()
    after = range(10 + count, 13 + count)
    found = run((DRIVE[index] for index in after), by)
    assert found[-1].state is TrackingState.TRACKING
    metres, degrees = errors(found[-1], true_pose(after[-1]))
    assert metres < 0.005  # the wall is recognised: what was driven blindly does not count
    assert degrees < 0.1


def test_recovered_where_nothing_is_recognised_with_a_growing_covariance() -> None:
    by = localiser()
    before = run(DRIVE[:10], by)[-1]
    by.process(black(10))
    # Turned by half a radian to the left: another part of the wall.
    turned = [Transform.from_quat([0.2, 1.5 + 0.015 * step, 0.8], [0, 0, 0.05, 1.0]) for step in range(6)]
    found = run(
        [stereo_pair(START_NS + (11 + k) * PERIOD_NS, T @ T_RB_LOCSB, LOC_RIG) for k, T in enumerate(turned)], by
    )
    first = next(i for i, e in enumerate(found) if e.state is TrackingState.DEGRADED)
    assert first < 3
    np.testing.assert_allclose(found[first].T_ds_rb.matrix, before.T_ds_rb.matrix, atol=1e-12)
    assert (np.diag(found[first].covariance)[:3] > 100 * np.diag(before.covariance)[:3]).all()
    assert np.linalg.norm(found[-1].T_ds_rb.translation - before.T_ds_rb.translation) < 0.2


@pytest.mark.parametrize("dark", [black, lambda index: replace(DRIVE[index], right=BLACK)])
def test_what_moved_before_the_first_image_is_in_the_covariance(dark: Callable[[int], StereoPair]) -> None:
    """The start pose holds at the first pair, which shows nothing; the rover is elsewhere when it sees."""
    by = localiser()
    for index in range(4):
        estimate = by.process(dark(index))
        assert (estimate.state, estimate.reason) == (TrackingState.LOST, StateReason.UNTEXTURED_IMAGES)
    found = run(DRIVE[4:25], by)
    assert (found[0].state, found[0].reason) == (TrackingState.DEGRADED, StateReason.UNSEEN_MOTION)
    np.testing.assert_allclose(found[0].T_ds_rb.matrix, true_pose(0).matrix, atol=1e-12)
    assert errors(found[-1], true_pose(24))[0] > 0.05
    for index, estimate in enumerate(found, 4):
        assert errors(estimate, true_pose(index))[0] < 2.0 * sigma(estimate)


# ---- images of another moment or camera


def test_a_pair_that_stays_is_ever_less_certain_until_another_comes() -> None:
    again = [replace(DRIVE[3], stamp_ns=DRIVE[3].stamp_ns + k * PERIOD_NS) for k in range(1, 4)]
    estimates = run([*DRIVE[:4], *again, DRIVE[7]])
    for estimate in estimates[4:7]:
        assert (estimate.state, estimate.reason) == (TrackingState.DEGRADED, StateReason.REPEATED_IMAGES)
        assert estimate.statistics.repeated == 1
        np.testing.assert_array_equal(estimate.T_ds_rb.matrix, estimates[3].T_ds_rb.matrix)
    sigmas = [sigma(estimate) for estimate in estimates[3:7]]
    assert (np.diff(sigmas) > 0.01).all()
    assert sigma(estimates[7]) < sigmas[1]
    assert errors(estimates[7], true_pose(7))[0] < 0.003


def test_wheel_odometry_counts_from_the_last_accepted_pair() -> None:
    by = localiser()
    assert by.known_ns is None
    run(DRIVE[:4], by)
    for refused in (replace(DRIVE[3], stamp_ns=DRIVE[4].stamp_ns), black(5)):
        by.process(refused)
        assert by.known_ns == DRIVE[3].stamp_ns
    by.process(DRIVE[6])
    assert by.known_ns == DRIVE[6].stamp_ns


@pytest.mark.parametrize("fault", ["swapped", "identical"])
def test_images_that_are_no_stereo_pair_are_lost_and_begin_no_window(fault: str) -> None:
    def mixed(pair: StereoPair) -> StereoPair:
        return replace(pair, left=pair.right if fault == "swapped" else pair.left, right=pair.left)

    estimates = run([*DRIVE[:3], *map(mixed, DRIVE[3:5]), *DRIVE[5:7]])
    assert [estimate.state.value for estimate in estimates[3:]] == ["lost", "lost", "tracking", "tracking"]
    assert estimates[3].reason is StateReason.NO_STEREO
    np.testing.assert_array_equal(estimates[4].T_ds_rb.matrix, estimates[2].T_ds_rb.matrix)
    assert errors(estimates[6], true_pose(6))[0] < 0.003
    first = run([*map(mixed, DRIVE[:3]), DRIVE[3]])
    assert [estimate.state.value for estimate in first] == ["lost", "lost", "lost", "degraded"]
    assert {estimate.reason for estimate in first[:3]} == {StateReason.NO_STEREO}


@pytest.mark.parametrize("sigma", [0.0, 2.0])
def test_a_copy_of_one_image_is_no_stereo_pair_even_if_some_pixels_differ(sigma: float) -> None:
    random = np.random.default_rng(1)

    def copied(pair: StereoPair) -> StereoPair:
        right = noisy(pair.left, sigma, random)
        right[5, 5] ^= 128
        return replace(pair, right=right)

    for pairs in ([copied(DRIVE[0])], [*DRIVE[:3], copied(DRIVE[3])]):
        estimate = run(pairs)[-1]
        assert (estimate.state, estimate.reason) == (TrackingState.LOST, StateReason.NO_STEREO)


COVERED = {
    "black": np.zeros((HEIGHT, WIDTH), np.uint8),
    "overexposed": np.full((HEIGHT, WIDTH), 255, np.uint8),
    "covered": noisy(np.full((HEIGHT, WIDTH), 90.0), 2.0, np.random.default_rng(1)),
    "noise": np.random.default_rng(2).integers(0, 255, (HEIGHT, WIDTH), np.uint8),
}


@pytest.mark.parametrize("image", COVERED)
@pytest.mark.parametrize("side", ["left", "right"])
def test_pairs_with_one_useless_image_have_a_reason_and_become_no_keyframes(side: str, image: str) -> None:
    broken = [
        replace(pair, **{side: np.roll(COVERED[image], 5 * index, axis=1)}) for index, pair in enumerate(DRIVE[6:20])
    ]
    estimates = run([*DRIVE[:6], *broken])
    keyframes = {estimate.statistics.keyframes for estimate in estimates[5:]} - {None}
    assert len(keyframes) == 1
    reasons = {estimate.reason for estimate in estimates[6:]}
    expected = {StateReason.UNTEXTURED_IMAGES}
    if image == "noise":
        expected = {StateReason.TORN_IMAGES, StateReason.FEW_LANDMARKS}
    assert reasons <= expected | {StateReason.REPEATED_IMAGES}
    for estimate, truth in zip(estimates[6:], map(true_pose, range(6, 20)), strict=True):
        assert estimate.state in (TrackingState.DEGRADED, TrackingState.LOST)
        if estimate.state is TrackingState.DEGRADED:
            assert errors(estimate, truth)[0] < max(0.01, 3.0 * sigma(estimate))


def test_excluded_cells_do_not_prevent_a_new_window_for_ever() -> None:
    by = localiser()
    run(DRIVE[:3], by)
    memory = by._state.ground_memory
    all_cells = np.ones(memory.excluded.life.shape, np.bool_)
    exclusion = Exclusion(np.zeros(1, np.intp), ~all_cells, all_cells)
    excluded = memory.excluded.after_pair(exclusion, ~all_cells, (HEIGHT, WIDTH))
    by._state = by._state._replace(landmark_map=None, ground_memory=memory._replace(excluded=excluded))
    states = [estimate.state for estimate in run(DRIVE[3 : 4 + DYNAMIC_LIFE], by)]
    assert states[0] is TrackingState.LOST
    assert states[-1] is not TrackingState.LOST


@pytest.mark.parametrize("side", [0, 30, 45])
def test_a_first_pair_with_little_texture_is_not_reported_as_swapped(side: int) -> None:
    """Only a square has texture, in the order of the cameras."""
    left = np.full((HEIGHT, WIDTH), 128, np.uint8)
    right = left.copy()
    inside = np.s_[40 : 40 + side, 60 : 60 + side]
    left[inside] = DRIVE[0].left[inside]
    right[inside] = DRIVE[0].right[inside]
    estimate = run([replace(DRIVE[0], left=left, right=right)])[0]
    assert estimate.reason in (None, StateReason.FEW_LANDMARKS, StateReason.UNTEXTURED_IMAGES)


@pytest.mark.parametrize("fault", ["swapped", "identical", "black", "repeated"])
def test_nothing_is_learnt_from_the_pose_of_a_refused_pair(fault: str) -> None:
    pair = DRIVE[10]
    refused = {
        "swapped": replace(pair, left=pair.right, right=pair.left),
        "identical": replace(pair, right=pair.left),
        "black": black(10),
        "repeated": replace(DRIVE[9], stamp_ns=pair.stamp_ns),
    }[fault]
    of_refused, *found = run([*DRIVE[:10], refused, *DRIVE[11:13]])[-3:]
    assert of_refused.state is not TrackingState.TRACKING
    wanted = run([*DRIVE[:10], *DRIVE[11:13]])[-2:]
    for index, (estimate, without) in enumerate(zip(found, wanted, strict=True), 11):
        assert estimate.state is TrackingState.TRACKING
        assert errors(estimate, true_pose(index))[0] < 0.003
        assert estimate.statistics.keyframes == without.statistics.keyframes
        assert estimate.statistics.vertical_offset_px == pytest.approx(without.statistics.vertical_offset_px, abs=0.01)


# ---- keyframes


def test_a_keyframe_is_solved_for_by_all_landmarks_though_some_are_excluded() -> None:
    config = LocalisationConfig()
    by = Localiser(LOC_RIG, config)
    window = first_window(DRIVE[0], config)
    landmarks = window.landmark_map.landmarks
    are_followed = np.ones(len(landmarks.rows), np.bool_)
    are_followed[-5:] = False
    frame = StereoFrame.of(DRIVE[1])
    start = Pose.of(Transform.identity())
    tracks = Tracker(config.min_tracked, LOC_RIG.camera).refine(
        frame, landmarks.subset(are_followed), start, window.calibration.offset
    )
    smaller_map = window.landmark_map.deactivated(landmarks.rows[:10])
    ground = Ground.unselected(tracks, GroundMemory.none((HEIGHT, WIDTH)))
    candidate = Candidate(frame, smaller_map, ground, tracks, window.calibration, ShearMean())
    complete = by._with_all_landmarks(by._state.path.last, candidate)
    np.testing.assert_array_equal(complete.tracks.landmarks.rows, landmarks.rows[10:])


def with_keyframe_to_adopt(
    change: Callable[[KeyframeResult], KeyframeResult] = lambda result: result,
) -> tuple[Localiser, int]:
    """Return a localiser whose last pair became a keyframe with a changed result, and the index of the next pair."""
    executor = KeyframesAtOnce()
    by = localiser(executor=executor)
    number = 6
    run(DRIVE[:number], by)
    executor.change = change
    made = len(executor.results)
    while len(executor.results) == made:
        by.process(DRIVE[number])
        number += 1
    executor.change = lambda result: result
    return by, number


def singular(_: KeyframeResult) -> KeyframeResult:
    raise np.linalg.LinAlgError("singular matrix")


def diverged(result: KeyframeResult) -> KeyframeResult:
    """Return a keyframe whose window is displaced by 2 m along each axis."""
    window = result.landmark_map.window
    keyframes = window.problem.keyframes
    displaced = keyframes._replace(positions=keyframes.positions + 2.0)
    window = replace(window, problem=window.problem._replace(keyframes=displaced))
    return replace(result, landmark_map=replace(result.landmark_map, window=window))


# ---- poses that cannot be


def test_a_diverged_adjustment_is_reported_by_the_first_pair_that_can_begin_a_window() -> None:
    by, number = with_keyframe_to_adopt(singular)
    refused = by.process(replace(DRIVE[number], right=DRIVE[number - 1].right))
    assert (refused.state, refused.reason) == (TrackingState.LOST, StateReason.REPEATED_IMAGES)
    begun, later = run(DRIVE[number + 1 : number + 3], by)
    assert (begun.state, begun.reason) == (TrackingState.DEGRADED, StateReason.IMPLAUSIBLE_MOTION)
    assert (later.state, later.reason) == (TrackingState.DEGRADED, StateReason.UNSEEN_MOTION)


def test_a_window_that_begins_at_a_pose_from_outside_does_not_report_an_earlier_divergence() -> None:
    by, number = with_keyframe_to_adopt(singular)
    by.set_pose(StartPose(true_pose(number + 2), 1e-4 * np.eye(6), DRIVE[number + 2].stamp_ns))
    run([black(number + index) for index in range(3)], by)
    begun = by.process(DRIVE[number + 3])
    assert (begun.state, begun.reason) == (TrackingState.DEGRADED, StateReason.UNSEEN_MOTION)


@pytest.mark.parametrize("change", [singular, diverged])
def test_a_diverged_adjustment_begins_a_window_and_is_reported(
    change: Callable[[KeyframeResult], KeyframeResult],
) -> None:
    by, number = with_keyframe_to_adopt(change)
    begun, later = run(DRIVE[number : number + 2], by)
    assert (begun.state, begun.reason) == (TrackingState.DEGRADED, StateReason.IMPLAUSIBLE_MOTION)
    assert (later.state, later.reason) == (TrackingState.DEGRADED, StateReason.UNSEEN_MOTION)
    assert errors(later, true_pose(number + 1))[0] < 3.0 * sigma(later)


def test_a_window_after_a_gap_degrades_poses_until_it_is_full() -> None:
    """The count of further keyframes starts again with each gap, and also counts keyframes without a gap."""
    window_keyframes = LocalisationConfig().window_keyframes
    by = localiser()
    estimates = run([black(0), *DRIVE[1:]], by)
    assert [estimate.state for estimate in estimates[:2]] == [TrackingState.LOST, TrackingState.DEGRADED]
    for before, now in pairwise(estimates[1:]):
        assert now.statistics.keyframes is not None
        keyframes = before.statistics.keyframes or 1  # a pair that begins a window has no such statistic
        is_full = keyframes >= window_keyframes
        assert (now.state, now.reason) == (
            (TrackingState.TRACKING, None) if is_full else (TrackingState.DEGRADED, StateReason.UNSEEN_MOTION)
        )


def test_a_keyframe_is_kept_although_the_call_that_waited_for_it_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    by, number = with_keyframe_to_adopt()
    other, _ = with_keyframe_to_adopt()
    with monkeypatch.context() as patch:
        patch.setattr(Tracker, "align", None)
        with pytest.raises(TypeError):
            by.process(DRIVE[number])
    found, wanted = by.process(DRIVE[number]), other.process(DRIVE[number])
    assert found.T_ds_rb.matrix.tobytes() == wanted.T_ds_rb.matrix.tobytes()
    assert found.covariance.tobytes() == wanted.covariance.tobytes()


@pytest.mark.parametrize("jump_m", [20.0, float("nan")])
def test_an_absurd_pose_is_lost_and_not_kept(monkeypatch: pytest.MonkeyPatch, jump_m: float) -> None:
    by = localiser()
    before = run(DRIVE[:6], by)[-1]
    solve = Tracker.solve

    def leap(*arguments: object) -> Tracks:
        tracks = solve(*arguments)  # type: ignore[arg-type]
        return tracks._replace(pose=tracks.pose._replace(position=tracks.pose.position + jump_m))

    with monkeypatch.context() as patch:
        patch.setattr(Tracker, "solve", leap)
        estimate = by.process(DRIVE[6])
    assert (estimate.state, estimate.reason) == (TrackingState.LOST, StateReason.IMPLAUSIBLE_MOTION)
    np.testing.assert_array_equal(estimate.T_ds_rb.matrix, before.T_ds_rb.matrix)
    assert errors(by.process(DRIVE[7]), true_pose(7))[0] < 0.004


FRESH_PROCESS = """
import ast, importlib, pkgutil
from dataclasses import replace
from pathlib import Path
import cv2
import numpy as np
from numba.core.registry import CPUDispatcher
import sfr_loc_map.localisation as package
from helpers.made_scene import LOC_RIG, PERIOD_NS, START_NS, loc_pair, true_pose
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.localiser import Localiser

names = [info.name for info in pkgutil.walk_packages(package.__path__, package.__name__ + ".")]
modules = [importlib.import_module(name) for name in names]

def signatures():
    found = {}
    for module in modules:
        for name, item in vars(module).items():
            if isinstance(item, CPUDispatcher):
                found[f"{item.py_func.__module__}.{name}"] = [str(s) for s in item.signatures]
    return found

def called_by_python():
    for module in modules:
        for node in ast.walk(ast.parse(Path(module.__file__).read_text())):
            if isinstance(node, ast.FunctionDef) and "jit" not in " ".join(map(ast.unparse, node.decorator_list)):
                used = {each.id for each in ast.walk(node) if isinstance(each, ast.Name)}
                yield from (vars(module)[name] for name in used if isinstance(vars(module).get(name), CPUDispatcher))

localiser = Localiser(LOC_RIG, LocalisationConfig(), true_pose(0))
localiser.warm_up()
cold = {kernel.py_func.__qualname__ for kernel in called_by_python() if not kernel.signatures}
assert not cold, f"the warm-up does not call {cold}"
before = signatures()
compiled = {name.rsplit(".", 1)[-1] for name, forms in before.items() if forms}
assert compiled >= {"align_patches", "track_patches", "solve_pose", "_linearise"}, compiled
black = np.zeros((LOC_RIG.height, LOC_RIG.width), np.uint8)
states = set()
for number, index in enumerate([*range(20), None, *range(21, 30), None, *range(5, 10)]):
    pair = StereoPair(0, black, black) if index is None else loc_pair(index)
    pair = replace(pair, stamp_ns=START_NS + number * PERIOD_NS)
    for image in (pair.left, pair.right):
        image.flags.writeable = False  # as images of messages are
    states.add(localiser.process(pair).state.value)
assert states == {"initialising", "tracking", "lost"}, states
noise = np.random.default_rng(1).integers(0, 128, (1024, 1044), np.uint8)
texture = 2 * cv2.GaussianBlur(noise, (0, 0), 2.0)
left, right = (np.ascontiguousarray(texture[:, shift : shift + 1024]) for shift in (0, 20))
large = Localiser(replace(LOC_RIG, width=1024, height=1024), LocalisationConfig(), true_pose(0))
assert large.process(StereoPair(0, left, right)).state.value == "initialising"
after = signatures()
assert after == before, {name: after[name] for name in after if after[name] != before[name]}
"""


@pytest.mark.slow
def test_warm_up_leaves_nothing_to_compile() -> None:
    """In a process of its own: the other tests have compiled everything already."""
    paths = [str(Path(made_scene.__file__).parents[1]), os.environ.get("PYTHONPATH", "")]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, paths))}
    done = subprocess.run([sys.executable, "-c", FRESH_PROCESS], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
