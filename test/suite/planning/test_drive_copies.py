"""Copies of a drive are detected by their ground truth and images, so that they are not independent drives."""

from __future__ import annotations

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
        (trace_of_truth(TRUTH[1:], GREY), False),
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


def test_copies_of_copies_are_one_drive() -> None:
    """The path of the third trace is 14 mm from that of the first one, but 7 mm from that of the second one."""
    ends_m = [np.linspace(0.0, end_m, 200)[:, None] * [1.0, 0.0, 0.0] for end_m in (0.0, 0.007, 0.014)]
    sources = [recording(sha256=sha256) for sha256 in "abcd"]
    traces = [trace_of_truth(moved(offset_m), GREY) for offset_m in ends_m]
    assert not are_copies(traces[0], traces[2])
    traces.append(trace_of_truth(straight(200, 0.01, 2), GREY))
    assert [item.drive for item in with_drives(sources, traces)] == ["a", "a", "a", "d"]


@pytest.mark.parametrize(("waiting_s", "is_one_recording"), [(0.1, True), (5.0, True), (60.0, False), (-3.0, False)])
def test_parts_of_one_recording_are_one_drive(waiting_s: float, is_one_recording: bool) -> None:
    """The second part begins at a time after the end of the first part, which takes 20 s."""
    other = straight(200, 0.01, 2)
    stamps_ns = other.stamps_ns - other.stamps_ns[0] + TRUTH.stamps_ns[-1] + round(waiting_s * 1e9)
    later = Trajectory(stamps_ns, other.positions, other.quats_xyzw)
    assert are_copies(trace_of_truth(later, GREY[::-1]), ORIGINAL) is is_one_recording


def test_all_parts_of_one_recording_are_one_drive() -> None:
    sources = [recording(sha256=sha256) for sha256 in "abcde"]
    parts = [trace_of_truth(TRUTH[begin : begin + 40]) for begin in (80, 0, 160, 120, 40)]
    assert {item.drive for item in with_drives(sources, parts)} == {"a"}


def test_drives_whose_stamps_begin_at_one_time_are_not_parts_of_one_recording() -> None:
    traces = [trace_of_truth(straight(50 + seed, 0.01, seed)) for seed in range(1, 4)]
    assert drives_of(traces).tolist() == [0, 1, 2]


def test_a_copy_with_rounded_positions_and_a_copy_of_a_short_drive_are_copies() -> None:
    rounded = Trajectory(TRUTH.stamps_ns, np.round(TRUTH.positions, 3), TRUTH.quats_xyzw)
    assert are_copies(trace_of_truth(rounded, GREY), ORIGINAL)
    assert are_copies(trace_of_truth(moved(1e-9)[:3], GREY), trace_of_truth(TRUTH[:3], GREY))


def test_honest_drives_at_equal_speed_are_not_copies() -> None:
    traces = [trace_of_truth(straight(200, 0.001, seed)) for seed in range(1, 7)]
    sources = [recording(sha256=sha256) for sha256 in "abcdef"]
    assert len({item.drive for item in with_drives(sources, traces)}) == 6


def drive_at_constant_speed(count: int) -> Trajectory:
    """Return a straight drive without noise, as of a rail or an exact simulator."""
    return straight(count, 0.0, 0, 0.02)


def test_drives_at_constant_speed_with_other_images_are_not_copies() -> None:
    other = tuple(RNG.integers(0, 255, 64).tolist())
    drive = drive_at_constant_speed(200)
    assert not are_copies(trace_of_truth(drive, GREY), trace_of_truth(drive, other))


def test_drives_at_constant_speed_without_images_are_compared_by_their_path() -> None:
    traces = [trace_of_truth(drive_at_constant_speed(count)) for count in (200, 200, 260, 320)]
    assert drives_of(traces).tolist() == [0, 0, 2, 3]


def test_a_simulation_with_other_unused_settings_is_the_same_drive() -> None:
    drive = {"drive.segments": ("straight 2",)}
    changes: list[dict[str, object]] = [
        {},
        {"start_stamp_ns": 1_700_000_000_000_000_001},
        {"panorama.period_s": 1.5},
        {"nav.baseline_m": 0.16},
        {"seed": 4},
    ]
    settings = [{"seed": 3} | drive | change for change in changes]
    sources = [simulation(sha256, item) for sha256, item in zip("abcde", settings, strict=True)]
    assert [item.drive for item in with_drives(sources, [DriveTrace()] * 5)] == ["a", "a", "a", "a", "e"]


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
