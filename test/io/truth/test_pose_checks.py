"""Plausibility checks of true poses, each on both sides of its threshold."""

from __future__ import annotations

import numpy as np
import pytest

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.plausibility import LOST_VARIANCE
from sfr_loc_map.geometry.rotation import quat_normalised
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.stamps.stamp_checks import stray_stamps
from sfr_loc_map.io.truth.pose_checks import (
    check_poses,
    has_constant_attitude,
    has_constant_height,
    has_no_tilt,
    jumping_positions,
    largest_jump,
    marked_as_unknown,
    path_turns,
)
from sfr_loc_map.io.truth.recorded import RecordedTruth
from sfr_loc_map.message_stamps import NS_PER_S

COUNT = 60
STAMPS = 1_700_000_000 * NS_PER_S + np.arange(COUNT) * NS_PER_S
ALONG = np.linspace(0.0, 12.0, COUNT)
STRAIGHT = np.column_stack((ALONG, 0.0 * ALONG, 0.0 * ALONG))
IDENTITY = np.tile([0.0, 0.0, 0.0, 1.0], (COUNT, 1))


def bent(angle_deg: float) -> FloatArray:
    """Return a flat path of two straight halves with an angle between them."""
    angle = np.radians(angle_deg)
    second = np.maximum(ALONG - 6.0, 0.0)
    return np.column_stack((np.minimum(ALONG, 6.0) + second * np.cos(angle), second * np.sin(angle), 0.0 * ALONG))


def poses(positions: FloatArray, quats: FloatArray = IDENTITY) -> Trajectory:
    return Trajectory(STAMPS, positions, quats)


def recorded(positions: FloatArray, quats: FloatArray = IDENTITY, of: FloatArray | None = None) -> RecordedTruth:
    return RecordedTruth(poses(positions, quats), "x", of)


def yaws(tilt: float = 0.0) -> FloatArray:
    yaw = np.linspace(0.0, 0.7, COUNT)
    return quat_normalised(np.column_stack((np.full(COUNT, tilt), 0.0 * yaw, np.sin(yaw), np.cos(yaw))))


@pytest.mark.parametrize(
    ("rows", "stamps_ns", "is_stray"),
    [
        ([0, 30], 0, True),
        ([59], STAMPS[0] + 2 * 86_400 * NS_PER_S, True),
        ([59], STAMPS[0] + 43_200 * NS_PER_S, False),
        (list(range(12)), 0, False),
    ],
    ids=["zeros", "two days", "half a day", "one fifth"],
)
def test_stamps_far_from_the_others_are_stray(rows: list[int], stamps_ns: int, is_stray: bool) -> None:
    changed = STAMPS.copy()
    changed[rows] = stamps_ns
    assert np.flatnonzero(stray_stamps(changed)).tolist() == (rows if is_stray else [])


def test_two_stamps_are_never_stray() -> None:
    assert not stray_stamps(np.array([0, STAMPS[0]])).any()


@pytest.mark.parametrize(
    ("rows", "jump_m", "pause_s", "is_jump"),
    [
        ([20], 300.0, 0, True),
        ([20], 90.0, 0, False),
        ([20], 300.0, 4, False),
        (list(range(20, 32)), 9000.0, 0, True),
        ([20, 40], 300.0, 0, True),
    ],
    ids=["too fast", "below 100 m/s", "after a pause", "one fifth", "two"],
)
def test_a_position_that_no_vehicle_can_reach_is_a_jump(
    rows: list[int], jump_m: float, pause_s: int, is_jump: bool
) -> None:
    positions, stamps_ns = STRAIGHT.copy(), STAMPS.copy()
    positions[rows, 1] += jump_m
    stamps_ns[20:] += pause_s * NS_PER_S
    stamps_ns[21:] += pause_s * NS_PER_S
    assert np.flatnonzero(jumping_positions(stamps_ns, positions)).tolist() == (rows if is_jump else [])


@pytest.mark.parametrize("fault", ["none", "one fifth away", "millimetres", "two bodies"])
def test_too_many_impossible_poses_are_kept_and_reported(fault: str) -> None:
    positions = STRAIGHT.copy()
    positions[20:32, 1] += 9000.0 if fault == "one fifth away" else 0.0
    positions *= 1000.0 if fault == "millimetres" else 1.0
    positions[::2, 1] += 300.0 if fault == "two bodies" else 0.0
    findings: list[str] = []
    checked = check_poses(recorded(positions), warn=findings.append)
    assert len(checked.recorded.poses) == COUNT
    assert ["100 m/s" in finding for finding in findings] == [True] * (fault != "none")


def test_a_jump_below_one_metre_at_equal_stamps_is_noise() -> None:
    positions = STRAIGHT.copy()
    positions[20, 1] += 0.9
    assert not jumping_positions(np.full(COUNT, STAMPS[0]), 0.001 * positions).any()


@pytest.mark.parametrize(
    ("angle_deg", "turns"), [(0.0, False), (15.0, False), (25.0, True), (90.0, True), (180.0, False)]
)
def test_a_path_turns_above_twenty_degrees_and_not_by_driving_back(angle_deg: float, turns: bool) -> None:
    assert path_turns(bent(angle_deg)) is turns


@pytest.mark.parametrize(("length_m", "turns"), [(0.4, False), (0.6, True)])
def test_a_path_below_half_a_metre_does_not_turn(length_m: float, turns: bool) -> None:
    assert path_turns(bent(90.0) * length_m / 12.0) is turns


def test_a_straight_path_with_one_step_to_the_side_does_not_turn() -> None:
    path = np.zeros((200, 3))
    path[:, 0] = np.linspace(0.0, 10.0, 200)
    path[120:, 1] = 0.6
    assert not path_turns(path)
    path[160:, 1] += np.linspace(0.0, 2.0, 40)
    assert path_turns(path)


def test_an_attitude_that_never_changes_is_detected_only_on_a_path_that_turns() -> None:
    signs = np.where(np.arange(COUNT) % 2, 1.0, -1.0)[:, None]
    assert has_constant_attitude(poses(bent(90.0)))
    assert has_constant_attitude(poses(bent(90.0), signs * IDENTITY)), "q and -q are the same attitude"
    assert not has_constant_attitude(poses(STRAIGHT))
    assert not has_constant_attitude(poses(bent(90.0), yaws()))
    assert not has_constant_attitude(poses(bent(90.0), np.zeros((COUNT, 4)))), "positions without attitude"


def test_a_height_that_never_changes_is_detected_only_on_a_path_that_turns() -> None:
    rough = bent(90.0)
    rough[:, 2] = 1e-4 * np.sin(ALONG)
    assert has_constant_height(poses(bent(90.0) + np.array([0.0, 0.0, 3.0])))
    assert not has_constant_height(poses(STRAIGHT))
    assert not has_constant_height(poses(rough))


def test_missing_roll_and_pitch_are_detected_only_on_a_path_that_turns() -> None:
    assert has_no_tilt(poses(bent(90.0), yaws()))
    assert not has_no_tilt(poses(STRAIGHT, yaws()))
    assert not has_no_tilt(poses(bent(90.0), yaws(tilt=0.01)))


def variances(**of: float) -> FloatArray:
    found = np.full((COUNT, 6), 0.01)
    for name, value in of.items():
        found[:, ("x", "y", "z", "roll", "pitch", "yaw").index(name)] = value
    return found


@pytest.mark.parametrize(
    ("of", "unknown"),
    [
        ({}, (False, False)),
        ({"z": LOST_VARIANCE}, (True, False)),
        ({"z": -1.0}, (True, False)),
        ({"roll": LOST_VARIANCE}, (False, False)),
        ({"roll": LOST_VARIANCE, "pitch": LOST_VARIANCE}, (False, True)),
        ({"z": 0.0, "roll": 0.0, "pitch": 0.0}, (True, True)),
        ({"x": 0.0, "y": 0.0, "z": 0.0, "roll": 0.0, "pitch": 0.0, "yaw": 0.0}, (False, False)),
    ],
    ids=["known", "no height", "negative", "roll", "no tilt", "planar", "zeros"],
)
def test_variances_mark_unknown_components(of: dict[str, float], unknown: tuple[bool, bool]) -> None:
    assert marked_as_unknown(variances(**of)) == unknown


def test_positions_without_height_are_ignored_if_most_have_a_height() -> None:
    few, most = variances(), variances()
    few[:5, 2] = LOST_VARIANCE
    most[:50, 2] = LOST_VARIANCE
    rough = bent(90.0) + np.column_stack((0.0 * ALONG, 0.0 * ALONG, 0.1 * np.sin(ALONG)))
    checked = check_poses(recorded(rough, yaws(0.01), few))
    assert checked.recorded.poses.stamps_ns.tolist() == STAMPS[5:].tolist()
    assert checked.recorded.variances is not None
    assert len(checked.recorded.variances) == COUNT - 5
    checked = check_poses(recorded(rough, yaws(0.01), most))
    assert len(checked.recorded.poses) == COUNT
    assert not checked.has_height
    assert checked.has_tilt


def test_settings_override_the_detection(caplog: pytest.LogCaptureFixture) -> None:
    flat = recorded(bent(90.0))
    assert not check_poses(flat).recorded.poses.has_attitude
    assert "all poses have the same attitude" in caplog.text
    assert check_poses(flat, attitude="yes").recorded.poses.has_attitude
    found = check_poses(recorded(bent(90.0), yaws()))
    assert not found.has_height
    assert not found.has_tilt
    found = check_poses(recorded(bent(90.0), yaws()), unknown="none")
    assert found.has_height
    assert found.has_tilt


@pytest.mark.parametrize(
    ("jump_m", "gap_s", "is_found"), [(30.0, 0, True), (0.5, 0, False), (30.0, 200, False), (0.0, 0, False)]
)
def test_a_jump_to_another_origin_is_reported(jump_m: float, gap_s: int, is_found: bool) -> None:
    positions, stamps_ns = STRAIGHT.copy(), STAMPS.copy()
    positions[30:] += [jump_m, 0.0, 0.0]
    stamps_ns[30:] += gap_s * NS_PER_S
    findings: list[str] = []
    checked = check_poses(RecordedTruth(Trajectory(stamps_ns, positions, IDENTITY), ""), warn=findings.append)
    assert len(checked.recorded.poses) == COUNT
    assert any("jump" in text for text in findings) == is_found


@pytest.mark.parametrize(
    ("rate_hz", "held", "speed", "moving"),
    [(100.0, 20, 8.0, 1.0), (100.0, 100, 1.2, 1.0), (0.1, 1, 1.0, 0.05)],
    ids=["GNSS of 5 Hz in a table of 100 Hz", "GNSS of 1 Hz in a table of 100 Hz", "total station, mostly at rest"],
)
@pytest.mark.parametrize("jump_m", [0.0, 500.0])
def test_a_held_pose_and_a_rest_are_not_jumps(
    rate_hz: float, held: int, speed: float, moving: float, jump_m: float
) -> None:
    rows = np.arange(4000)
    measured = rows // held * held
    positions = np.zeros((4000, 3))
    positions[:, 0] = np.maximum(measured - (1.0 - moving) * 4000, 0.0) * speed / rate_hz
    positions[3900:, 1] += jump_m
    found = largest_jump(np.round(rows * NS_PER_S / rate_hz).astype(np.int64), positions)
    assert bool(found) == (jump_m > 0.0)
