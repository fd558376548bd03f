"""Copies of a drive are detected by their ground truth and images, so that they are not independent drives."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest

from helpers.made_suites import JOB, recording, straight
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.suite.jobs.sources import Simulation
from sfr_loc_map.suite.planning.drive_copies import (
    DriveTrace,
    drives_of,
    trace_of_simulation,
    trace_of_truth,
    with_drives,
)

RNG = np.random.default_rng(5)
TRUTH = straight(200, 0.01, 1)
GREY = tuple(RNG.integers(0, 255, 64).tolist())
ORIGINAL = trace_of_truth(TRUTH, GREY)


def are_copies(first: DriveTrace, second: DriveTrace) -> bool:
    forwards, backwards = (len(set(drives_of(pair).tolist())) == 1 for pair in ([first, second], [second, first]))
    assert forwards == backwards
    return forwards


def moved(offset_m: object) -> Trajectory:
    return Trajectory(TRUTH.stamps_ns, TRUTH.positions + offset_m, TRUTH.quats_xyzw)


def continued(poses: int) -> Trajectory:
    """The first poses of the drive, and then another drive of 120 poses."""
    other = straight(120, 0.01, 2)
    positions = np.vstack((TRUTH.positions[:poses], other.positions + TRUTH.positions[poses]))
    stamps_ns = np.arange(len(positions)) * 100_000_000
    return Trajectory(stamps_ns, positions, np.vstack((TRUTH.quats_xyzw[:poses], other.quats_xyzw)))


def simulation(sha256: str, settings: dict[str, object]) -> Simulation:
    seed = int(str(settings["seed"]))
    return Simulation(name="a", path="a.yaml", sha256=sha256, drive=sha256, settings=settings, seed=seed)


@pytest.mark.parametrize(
    ("trace", "is_copy"),
    [
        (trace_of_truth(moved(1e-9), GREY), True),
        (trace_of_truth(moved([3.0, -2.0, 1.0]), GREY), True),
        (trace_of_truth(moved(np.linspace(0.0, 0.009, 200)[:, None] * [1.0, 0.0, 0.0]), GREY), True),
        (trace_of_truth(TRUTH, tuple(level + 3 for level in GREY)), True),
        (trace_of_truth(moved(np.linspace(0.0, 0.05, 200)[:, None] * [1.0, 0.0, 0.0]), GREY), False),
        (trace_of_truth(TRUTH, tuple(RNG.integers(0, 255, 64).tolist())), False),
        (trace_of_truth(TRUTH), False),
        (trace_of_truth(straight(200, 0.01, 2), GREY), False),
        (trace_of_truth(straight(199, 0.01, 2), GREY), False),
        (trace_of_truth(TRUTH[1:], GREY), True),
        (trace_of_truth(TRUTH[:110], GREY), True),
        (trace_of_truth(TRUTH[60:140], GREY), True),
        (trace_of_truth(continued(140), GREY), True),
        (trace_of_truth(continued(60), GREY), False),
        (trace_of_truth(TRUTH[:-1], tuple(RNG.integers(0, 255, 64).tolist())), False),
    ],
)
def test_a_copy_is_known_by_its_path_and_its_images(trace: DriveTrace, is_copy: bool) -> None:
    assert are_copies(trace, ORIGINAL) is is_copy
    assert not are_copies(DriveTrace(), DriveTrace()), "without ground truth nothing is known"


@pytest.mark.parametrize(("grey", "is_copy"), [((), False), (GREY, True)], ids=["no images", "equal images"])
def test_stationary_drives_are_copies_only_by_their_images(grey: tuple[int, ...], is_copy: bool) -> None:
    """Two rovers stand at places 1000 m apart; their relative paths agree."""
    standing = Trajectory(TRUTH.stamps_ns, np.zeros_like(TRUTH.positions), TRUTH.quats_xyzw[:1].repeat(200, axis=0))
    elsewhere = replace(standing, positions=standing.positions + np.array([1000.0, 0.0, 0.0]))
    assert are_copies(trace_of_truth(standing, grey), trace_of_truth(elsewhere, grey)) is is_copy


def test_a_turned_copy_is_a_copy() -> None:
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    poses = [TRUTH.pose(index) for index in range(len(TRUTH))]
    turned = Trajectory.from_poses(
        (int(stamp), replace(pose, rotation=turn @ pose.rotation, translation=turn @ pose.translation))
        for stamp, pose in zip(TRUTH.stamps_ns, poses, strict=True)
    )
    assert are_copies(trace_of_truth(turned, GREY), ORIGINAL)
    assert are_copies(trace_of_truth(turned[:3], GREY), trace_of_truth(TRUTH[:3], GREY)), (
        "three poses have too few steps"
    )


def test_a_copy_with_rounded_positions_and_a_copy_of_a_short_drive_are_copies() -> None:
    """Rounding to 1 mm changes the steps by more than their tolerance, and three poses have too few steps."""
    rounded = Trajectory(TRUTH.stamps_ns, np.round(TRUTH.positions, 3), TRUTH.quats_xyzw)
    assert are_copies(trace_of_truth(rounded, GREY), ORIGINAL)
    assert are_copies(trace_of_truth(moved(1e-9)[:3], GREY), trace_of_truth(TRUTH[:3], GREY))


def test_a_copy_with_another_attitude_of_its_first_pose_is_a_copy() -> None:
    """The frame of the first pose turns the end of the path by 20 mm."""
    quats = TRUTH.quats_xyzw.copy()
    half = 0.5 * np.radians(0.06)
    quats[0] = [0.0, 0.0, np.sin(half), np.cos(half)]
    assert are_copies(trace_of_truth(Trajectory(TRUTH.stamps_ns, TRUTH.positions, quats)), trace_of_truth(TRUTH))


def test_copies_that_lack_poses_are_one_drive() -> None:
    sources = [recording(sha256=sha256) for sha256 in "abcdef"]
    nested = [trace_of_truth(TRUTH[: 200 - lacking]) for lacking in range(6)]
    assert {item.drive for item in with_drives(sources, nested)} == {"a"}


def test_copies_of_copies_are_one_drive() -> None:
    """The first and the last part have no step in common, but both are parts of the complete drive."""
    sources = [recording(sha256=sha256) for sha256 in "abcd"]
    traces = [
        trace_of_truth(TRUTH[:90]),
        trace_of_truth(TRUTH[110:]),
        trace_of_truth(TRUTH),
        trace_of_truth(straight(200, 0.01, 2)),
    ]
    assert [item.drive for item in with_drives(sources, traces)] == ["a", "a", "a", "d"]


@pytest.mark.parametrize(
    ("waiting_s", "aside_m", "is_one_recording"),
    [(0.1, 0.1, True), (5.0, 0.3, True), (-3.0, 0.0, True), (60.0, 0.0, False), (0.1, 5.0, False), (-20.0, 0.0, False)],
)
def test_parts_of_one_recording_are_one_drive(waiting_s: float, aside_m: float, is_one_recording: bool) -> None:
    """The second part begins at a time and a distance after the end of the first part, which takes 20 s."""
    other = straight(200, 0.01, 2)
    stamps_ns = other.stamps_ns - other.stamps_ns[0] + TRUTH.stamps_ns[-1] + round(waiting_s * 1e9)
    positions = other.positions - other.positions[0] + TRUTH.positions[-1] + [aside_m, 0.0, 0.0]
    later = Trajectory(stamps_ns, positions, other.quats_xyzw)
    assert are_copies(trace_of_truth(later, GREY[::-1]), ORIGINAL) is is_one_recording


def test_parts_of_one_recording_without_common_poses_are_one_drive() -> None:
    sources = [recording(sha256=sha256) for sha256 in "abcde"]
    parts = [trace_of_truth(TRUTH[begin : begin + 40]) for begin in (80, 0, 160, 120, 40)]
    assert {item.drive for item in with_drives(sources, parts)} == {"a"}


def test_short_drives_that_begin_at_one_time_and_place_are_not_parts_of_one_recording() -> None:
    """Each drive takes 5 s, and its stamps begin at 0."""
    traces = [trace_of_truth(straight(50 + seed, 0.01, seed)) for seed in range(1, 4)]
    assert drives_of(traces).tolist() == [0, 1, 2]


def test_honest_drives_at_equal_speed_are_not_copies() -> None:
    traces = [trace_of_truth(straight(200, 0.001, seed)) for seed in range(1, 7)]
    sources = [recording(sha256=sha256) for sha256 in "abcdef"]
    assert len({item.drive for item in with_drives(sources, traces)}) == 6


def drive_at_constant_speed(count: int, waiting: int = 0, step_m: float = 0.02) -> Trajectory:
    """Return a straight drive without noise, as of a rail or an exact simulator, that stands still at first."""
    drive = straight(count + waiting, 0.0, 0, step_m)
    standing = np.repeat(drive.positions[:1], waiting, axis=0)
    return Trajectory(drive.stamps_ns, np.vstack((standing, drive.positions[:count])), drive.quats_xyzw)


@pytest.mark.parametrize("waiting", [0, 10])
def test_drives_at_constant_speed_with_other_images_are_not_copies(waiting: int) -> None:
    other = tuple(RNG.integers(0, 255, 64).tolist())
    first, second = drive_at_constant_speed(200), drive_at_constant_speed(200, waiting)
    assert not are_copies(trace_of_truth(first, GREY), trace_of_truth(second, other))


def test_a_drive_with_other_images_that_stands_still_at_first_is_not_a_copy() -> None:
    standing = np.repeat(TRUTH.positions[:1], 10, axis=0)
    later = Trajectory(
        straight(210, 0.0, 0).stamps_ns, np.vstack((standing, TRUTH.positions)), straight(210, 0.0, 0).quats_xyzw
    )
    assert not are_copies(trace_of_truth(later, tuple(RNG.integers(0, 255, 64).tolist())), ORIGINAL)
    assert are_copies(trace_of_truth(later, GREY), ORIGINAL)


def test_drives_at_constant_speed_without_images_are_compared_by_their_path() -> None:
    traces = [trace_of_truth(drive_at_constant_speed(count)) for count in (200, 200, 260, 320)]
    assert drives_of(traces).tolist() == [0, 0, 2, 3]


def test_drives_that_share_only_their_acceleration_are_not_copies() -> None:
    """The drives have no images, equal ramps of the speed, and different lengths."""
    ramp = np.linspace(0.005, 0.02, 12)

    def accelerated(count: int) -> DriveTrace:
        steps = np.concatenate((ramp, np.full(count, 0.02), ramp[::-1]))
        drive = straight(len(steps) + 1, 0.0, 0)
        places = np.column_stack((np.cumsum(np.concatenate(([0.0], steps))), np.zeros((len(drive), 2))))
        return trace_of_truth(Trajectory(drive.stamps_ns, places, drive.quats_xyzw))

    assert not are_copies(accelerated(150), accelerated(250))


def test_the_time_to_find_copies_is_linear_in_the_number_of_drives() -> None:
    """Each of the 2800 pairs of these drives by itself takes more than 10 ms."""
    rng = np.random.default_rng(1)
    steps = rng.uniform(0.05, 0.1, (74, 2000))
    steps = np.vstack((steps, steps[:1]))
    traces = [
        DriveTrace(2001, tuple(rng.normal(0.0, 9.0, 300)), steps_m=tuple(row), bends_m=tuple(row[1:])) for row in steps
    ]
    begin = time.process_time()
    assert drives_of(traces).tolist() == [*range(74), drives_of(traces[:1])[0]]
    assert time.process_time() - begin < 10.0


def test_a_simulation_with_other_unused_settings_is_the_same_drive() -> None:
    drive = {"drive.segments": ("straight 2",)}
    changes: list[dict[str, object]] = [
        {},
        {"start_stamp_ns": 1_700_000_000_000_000_001},
        {"panorama.period_s": 1.5},
        {"nav.baseline_m": 0.16},
        {"drive.pairs": 20},
        {"seed": 4},
    ]
    settings = [{"seed": 3} | drive | change for change in changes]
    sources = [simulation(sha256, item) for sha256, item in zip("abcdef", settings, strict=True)]
    assert [item.drive for item in with_drives(sources, [DriveTrace()] * 6)] == ["a", "a", "a", "a", "a", "f"]


def test_simulations_with_other_seeds_are_other_drives() -> None:
    """Without disturbances the paths are equal, but the terrain differs."""
    flat = {"terrain.relief_m": 0.0, "drive.slip": 0.0, "drive.sway_m": 0.0, "drive.sway_deg": 0.0}
    flat |= {"drive.vibration_deg": 0.0, "drive.vibration_m": 0.0}
    sources = [simulation(str(seed), {"seed": seed} | flat) for seed in (1, 2)]
    traces = [trace_of_simulation(source) for source in sources]
    assert not are_copies(*traces)


def test_copies_name_one_drive_whatever_their_order() -> None:
    traces = [trace_of_truth(moved(1e-6), GREY), ORIGINAL, trace_of_truth(straight(200, 0.01, 2), GREY)]
    files = [recording(sha256=sha256) for sha256 in "cab"]
    drives = [item.drive for item in with_drives(files, traces)]
    assert drives == ["a", "a", "b"]
    assert [item.drive for item in with_drives(files[::-1], traces[::-1])] == drives[::-1]
    first, second, other = (replace(JOB, source=item) for item in with_drives(files, traces))
    assert first.drive_key == second.drive_key != other.drive_key
    assert first.key != second.key, "each is run"
