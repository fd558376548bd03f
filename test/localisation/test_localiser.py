"""The localiser in a small world that is known exactly: a rover before a textured wall."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import made_scene
import numpy as np
import pytest
from loc_drive import black, drive, errors, localiser, noisy, run
from made_scene import HEIGHT, LOC_RIG, PERIOD_NS, START_NS, T_RB_LOCSB, WIDTH, true_pose

from sfr_loc_map.errors import GeometryError, LocalisationError
from sfr_loc_map.geometry.rotation import rotvec_from_matrix
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.geometry.transform import Transform, propagated_covariance
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.estimate import PoseEstimate, StateReason, TrackingState
from sfr_loc_map.localisation.frontend.right_offset import RightOffset
from sfr_loc_map.localisation.localiser import Localiser
from sfr_loc_map.localisation.start_pose import StartPose

DRIVE = drive()


@pytest.fixture(scope="module")
def estimates() -> list[PoseEstimate]:
    return run(DRIVE)


def test_without_noise_the_error_is_near_zero(estimates: list[PoseEstimate]) -> None:
    # About 1 m of driving at 3 m from the wall; what is left comes from images rounded to whole grey levels.
    for index, estimate in enumerate(estimates):
        metres, degrees = errors(estimate, true_pose(index))
        assert metres < 0.003, index
        assert degrees < 0.06, index


@pytest.mark.clause("1.3")
def test_first_pose_is_the_one_given_and_every_pair_has_a_pose(estimates: list[PoseEstimate]) -> None:
    np.testing.assert_allclose(estimates[0].T_ds_rb.matrix, true_pose(0).matrix, atol=1e-12)
    assert [estimate.stamp_ns for estimate in estimates] == [pair.stamp_ns for pair in DRIVE]
    assert [e.state for e in estimates] == [TrackingState.INITIALISING] + [TrackingState.TRACKING] * 39


def test_covariance_is_one_and_agrees_with_the_error(estimates: list[PoseEstimate]) -> None:
    for index, estimate in enumerate(estimates[1:], start=1):
        np.testing.assert_array_equal(estimate.covariance, estimate.covariance.T)
        assert np.linalg.eigvalsh(estimate.covariance).min() > 0
        sigma = np.sqrt(np.trace(estimate.covariance[:3, :3]))
        # a wall alone says little of the right camera's yaw, by which the path may be off
        assert errors(estimate, true_pose(index))[0] < 4 * sigma < 0.08
    growth = [float(np.trace(e.covariance[:3, :3])) for e in (estimates[2], estimates[-1])]
    assert growth[1] > growth[0]


def test_error_grows_with_noise(estimates: list[PoseEstimate]) -> None:
    rng = np.random.default_rng(7)
    worse = run(StereoPair(pair.stamp_ns, noisy(pair.left, 10.0, rng), noisy(pair.right, 10.0, rng)) for pair in DRIVE)
    assert all(estimate.state is not TrackingState.LOST for estimate in worse)
    means = [np.mean([errors(e, true_pose(i))[0] for i, e in enumerate(found)]) for found in (estimates, worse)]
    assert means[0] < means[1] < 0.05


def test_same_pairs_give_the_same_bits(estimates: list[PoseEstimate]) -> None:
    by = localiser()
    run(DRIVE[5:9], by)
    by.reset(true_pose(0))
    for again in (run(DRIVE), run(DRIVE, by)):
        for a, b in zip(again, estimates, strict=True):
            assert a.T_ds_rb.matrix.tobytes() == b.T_ds_rb.matrix.tobytes()
            assert a.covariance.tobytes() == b.covariance.tobytes()
            assert repr((a.state, a.statistics)) == repr((b.state, b.statistics))  # NaN is equal to itself here


def test_bits_do_not_depend_on_how_fast_pairs_come(estimates: list[PoseEstimate]) -> None:
    """Keyframe work goes on between the calls: it ends early, late, or beside that of another localiser."""
    by, beside = localiser(), localiser()
    for index, pair in enumerate(DRIVE):
        estimate = by.process(pair)
        beside.process(DRIVE[-1 - index])
        time.sleep(0.03 * (index % 3))
        assert estimate.T_ds_rb.matrix.tobytes() == estimates[index].T_ds_rb.matrix.tobytes()
        assert estimate.covariance.tobytes() == estimates[index].covariance.tobytes()


def test_stages_of_a_call_are_timed(estimates: list[PoseEstimate]) -> None:
    keyframes = np.array([e.statistics.keyframes or 0 for e in estimates])
    for index, estimate in enumerate(estimates):
        assert all(seconds >= 0.0 for seconds in estimate.stage_s.values())
        assert {"wait", "pyramid"} <= set(estimate.stage_s)
        after_keyframe = index > 1 and keyframes[index - 1] > keyframes[index - 2] > 0
        assert ("keyframe" in estimate.stage_s) == after_keyframe or index < 3
    assert sum("keyframe" in e.stage_s for e in estimates) >= 3
    assert estimates[5].figures["stage_align_s"] == estimates[5].stage_s["align"]


def test_an_estimate_keeps_its_stage_times_whatever_follows() -> None:
    by = localiser()
    for index, pair in enumerate(DRIVE[:14]):  # two of them are keyframes, in work after the call
        estimate = by.process(pair)
        before = dict(estimate.stage_s)
        by.set_pose(true_pose(index))
        assert dict(estimate.stage_s) == before
    with pytest.raises(TypeError):
        estimate.stage_s["wait"] = 0.0  # type: ignore[index]


def test_statistics_state_what_the_right_camera_is_off_by() -> None:
    by = localiser()
    run(DRIVE[:2], by)
    by._backend.calibration.offset = RightOffset(u=0.2, v=-0.1, roll=0.3)
    found = by.process(DRIVE[2]).statistics
    # right positions too far right: disparities too small
    assert (found.disparity_offset_px, found.vertical_offset_px, found.roll_offset_px) == (-0.2, -0.1, 0.3)


def test_the_next_pose_is_predicted_from_the_last_motion() -> None:
    by = localiser()
    run(DRIVE[:5], by)
    predicted, still = by._motion.predictions(by._track.T_world_left, DRIVE[5].stamp_ns, None)
    first, now = (true_pose(index) @ LOC_RIG.T_rb_left for index in (0, 5))
    error, step = (
        float(np.linalg.norm(pose.translation - (first.inverse() @ now).translation)) for pose in (predicted, still)
    )
    assert error < 0.2 * step


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


def test_the_start_moves_the_whole_trajectory(estimates: list[PoseEstimate]) -> None:
    T_other = Transform.from_quat([100.0, -20.0, 3.0], [0.1, -0.3, 0.7, 0.64])
    moved = run(DRIVE[:10], localiser(T_other))
    for a, b in zip(moved, estimates, strict=False):
        wanted = T_other @ true_pose(0).inverse() @ b.T_ds_rb
        np.testing.assert_allclose(a.T_ds_rb.matrix, wanted.matrix, atol=1e-9)


def test_pair_of_another_size_is_refused_and_changes_nothing(estimates: list[PoseEstimate]) -> None:
    by = localiser()
    run(DRIVE[:3], by)
    wide = np.zeros((HEIGHT, WIDTH + 1), np.uint8)
    with pytest.raises(LocalisationError, match=r"pair 5 is 161 x 120, the rig is 160 x 120"):
        by.process(StereoPair(5, wide, wide))
    assert by.process(DRIVE[3]).T_ds_rb.matrix.tobytes() == estimates[3].T_ds_rb.matrix.tobytes()


def test_rig_without_extrinsics_is_refused() -> None:
    with pytest.raises(GeometryError, match="T_rb_locsb"):
        Localiser(replace(LOC_RIG, T_rb_sb=None), LocalisationConfig(), Transform.identity())


def test_standing_still_stays_within_a_millimetre() -> None:
    rng = np.random.default_rng(3)
    by = localiser()
    for index in range(100):
        images = (noisy(side, 1.0, rng) for side in (DRIVE[0].left, DRIVE[0].right))
        estimate = by.process(StereoPair(START_NS + index * PERIOD_NS, *images))
        assert errors(estimate, true_pose(0))[0] < 0.001, index


def test_set_pose_is_where_the_next_estimate_starts(estimates: list[PoseEstimate]) -> None:
    T_set = Transform.from_quat([7.0, 8.0, 9.0], [0.0, 0.1, 0.7, 0.7])
    by = localiser()
    run(DRIVE[:10], by)
    by.set_pose(T_set)
    for index in range(10, 14):
        motion = estimates[10].T_ds_rb.inverse() @ estimates[index].T_ds_rb
        found = by.process(DRIVE[index])
        np.testing.assert_allclose(found.T_ds_rb.matrix, (T_set @ motion).matrix, atol=1e-9)
        assert found.state is TrackingState.TRACKING


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
    assert steps[8] is None
    assert steps[0] is not None
    assert steps[0].seconds == 0.0
    variance = 0.0
    for step in steps[6:8]:
        assert step is not None
        np.testing.assert_array_equal(step.motion, 0.0)
        variance += step.covariance[0, 0]
    assert np.sqrt(variance) == pytest.approx(0.2, rel=0.2)  # 1 m/s over both together
    assert steps[9] is not None
    assert steps[10] is not None
    assert np.sqrt(steps[9].covariance[0, 0]) == pytest.approx(0.2, rel=0.2)  # from a pose that was kept
    assert np.sqrt(steps[10].covariance[0, 0]) < 0.02


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


def test_a_start_pose_of_a_later_pair_holds_there(estimates: list[PoseEstimate]) -> None:
    by = Localiser(LOC_RIG, LocalisationConfig(), StartPose(true_pose(5), stamp_ns=DRIVE[5].stamp_ns))
    found = run(DRIVE[:9], by)
    assert found[0].state is TrackingState.DEGRADED
    assert found[0].covariance[0, 0] > 0.4**2  # 1 m/s
    for index in range(5, 9):
        motion = estimates[5].T_ds_rb.inverse() @ estimates[index].T_ds_rb
        assert errors(found[index], true_pose(5) @ motion)[0] < 1e-6
        assert np.trace(found[index].covariance[:3, :3]) < 0.02**2


def test_a_pose_between_two_pairs_holds_between_their_poses() -> None:
    by = localiser()
    run(DRIVE[:10], by)
    between = 0.5 * (true_pose(9).translation + true_pose(10).translation)
    stamp_ns = (DRIVE[9].stamp_ns + DRIVE[10].stamp_ns) // 2
    by.set_pose(StartPose(Transform(true_pose(9).rotation, between + np.array([1.0, 0.0, 0.0])), stamp_ns=stamp_ns))
    error = by.process(DRIVE[10]).T_ds_rb.translation - true_pose(10).translation
    np.testing.assert_allclose(error, [1.0, 0.0, 0.0], atol=0.004)


@pytest.mark.parametrize("stamped", [False, True])
def test_a_pose_set_while_lost_is_of_its_stamp_or_the_next_pair(*, stamped: bool) -> None:
    """It says nothing of the last known pose, which is of before the gap."""
    by, sigma = localiser(), 0.01
    run([*DRIVE[:10], black(10)], by)
    pose, covariance = true_pose(11), sigma**2 * np.eye(6)
    by.set_pose(StartPose(pose, covariance, DRIVE[11].stamp_ns if stamped else None))
    by.process(black(11))
    found = run(DRIVE[16:20], by)
    assert (found[0].state, found[0].reason) == (TrackingState.DEGRADED, StateReason.UNSEEN_MOTION)
    np.testing.assert_allclose(found[0].T_ds_rb.matrix, pose.matrix, atol=1e-9)
    for index, estimate in enumerate(found, 16):
        assert errors(estimate, true_pose(index))[0] < np.sqrt(np.trace(estimate.covariance[:3, :3]))


def test_a_pose_set_while_lost_for_a_pair_that_shows_something_is_exact() -> None:
    by = localiser()
    run([*DRIVE[:10], black(10)], by)
    by.set_pose(StartPose(true_pose(16), stamp_ns=DRIVE[16].stamp_ns))
    assert errors(by.process(DRIVE[16]), true_pose(16))[0] < 1e-9
    assert errors(by.process(DRIVE[18]), true_pose(18))[0] < 0.003


def test_a_stamp_far_ahead_is_of_another_clock() -> None:
    by = localiser()
    run(DRIVE[:3], by)
    by.set_pose(StartPose(true_pose(20), stamp_ns=DRIVE[3].stamp_ns + 10**18))
    np.testing.assert_allclose(by.process(DRIVE[3]).T_ds_rb.matrix, true_pose(20).matrix, atol=1e-9)


def test_set_pose_before_the_first_pair_is_its_pose() -> None:
    by = localiser()
    by.set_pose(true_pose(20))
    np.testing.assert_allclose(by.process(DRIVE[0]).T_ds_rb.matrix, true_pose(20).matrix, atol=1e-12)


FRESH_PROCESS = """
import importlib, pkgutil
from dataclasses import replace
import cv2
import numpy as np
from numba.core.registry import CPUDispatcher
import sfr_loc_map.localisation as package
from made_scene import LOC_RIG, loc_pair, true_pose
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.localisation.frontend.feature_detection import find_corners
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.frontend.right_offset import RightOffset
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

localiser = Localiser(LOC_RIG, LocalisationConfig(), true_pose(0))
localiser.warm_up()
before = signatures()
compiled = {name.rsplit(".", 1)[-1] for name, forms in before.items() if forms}
assert compiled >= {"_align", "track_patches", "solve_pose", "_linearise"}, compiled
black = np.zeros((LOC_RIG.height, LOC_RIG.width), np.uint8)
states = set()
for index in [*range(20), None, *range(21, 30), None, *range(5, 10)]:
    pair = StereoPair(0, black, black) if index is None else loc_pair(index)
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
    paths = [str(Path(made_scene.__file__).parent), os.environ.get("PYTHONPATH", "")]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, paths))}
    done = subprocess.run([sys.executable, "-c", FRESH_PROCESS], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_warm_up_does_not_change_the_state(estimates: list[PoseEstimate]) -> None:
    by = localiser()
    run(DRIVE[:5], by)
    by.warm_up()
    assert by.process(DRIVE[5]).T_ds_rb.matrix.tobytes() == estimates[5].T_ds_rb.matrix.tobytes()
