"""Poses that repeat another and poses of the ground truth, at the bounds from which they count."""

import numpy as np
import pytest

from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.metrics.completeness.copies import copy_rows, judged_of_truth, repeats_pose, resolution_of, scatter_m
from sfr_loc_map.metrics.frames.association import Frames
from sfr_loc_map.metrics.frames.motion import moving_steps
from sfr_loc_map.metrics.score.score import Score

COUNT = 200
LEVEL = np.tile([0.0, 0.0, 0.0, 1.0], (COUNT, 1))
STAMPS = np.arange(COUNT) * 100_000_000


def along_x(places: np.ndarray) -> np.ndarray:
    return np.column_stack((places, np.zeros((len(places), 2))))


def frames(position: np.ndarray, true_position: np.ndarray) -> Frames:
    return Frames(STAMPS, true_position, LEVEL, position, LEVEL, np.arange(COUNT))


def counted(position: np.ndarray, true_position: np.ndarray, reported: np.ndarray | None = None) -> tuple[float, float]:
    """Return how many poses repeat the pose before, and how many are of the truth."""
    none = np.zeros(COUNT, np.bool_) if reported is None else reported
    truth = Trajectory(STAMPS, true_position, LEVEL)
    rows = Score(figures=tuple(copy_rows(frames(position, true_position), truth, none, interpolated=False)))
    repeated, copied = (rows.number(name, part="count") for name in ("poses_repeated", "poses_of_truth"))
    assert repeated is not None
    assert copied is not None
    return repeated, copied


TRUE = along_x(0.1 * np.arange(COUNT))
NOISE = np.cumsum(np.random.default_rng(1).normal(0.0, 1e-3, (COUNT, 3)), axis=0)


def test_copies_in_a_row_count_each_unless_they_are_reported() -> None:
    rows = np.arange(COUNT)
    rows[60:65] = 59
    copied = (TRUE + NOISE)[rows]
    assert counted(copied, TRUE) == (5, 0)
    reported = np.zeros(COUNT, np.bool_)
    reported[60:63] = True
    assert counted(copied, TRUE, reported) == (2, 0)


def test_a_pose_that_is_repeated_is_told_from_a_stop_a_slow_start_and_the_resolution_of_a_file() -> None:
    slow = np.append(np.linspace(0.0, 0.04, 50), 0.04 + 0.1 * np.arange(1, COUNT - 49))
    held = slow.copy()
    held[:50] = 0.0
    assert not repeats_pose(frames(along_x(held), along_x(slow))).any(), "0.04 m is less than half a step"
    held[49:51] = 0.0
    assert repeats_pose(frames(along_x(held), along_x(slow))).sum() == 1, "0.14 m are more"
    coarse = along_x(np.floor(0.07 * np.arange(COUNT)) * 0.1)
    assert not repeats_pose(frames(coarse, along_x(0.007 * np.arange(COUNT)))).any(), "steps of 0.1 m or none"
    stands = np.tile(TRUE[:1], (COUNT, 1))
    jitter = np.random.default_rng(2).normal(0.0, 1e-2, (COUNT, 3))
    assert not repeats_pose(frames(stands, stands + jitter)).any(), "the truth alone moves, by its noise"
    assert repeats_pose(frames(stands, TRUE)).sum() == COUNT - 1


def test_a_stop_with_a_drifting_truth_repeats_no_pose() -> None:
    """4 cm/s at 10 Hz, and a stop of 10 s with a zero-velocity update while the tracking drifts by 0.6 mm/s."""
    drives = 0.004 * np.arange(50)
    after = drives[-1] + 0.004 * np.arange(1, 51)
    drifts_m_s = np.array([0.0006, 0.001])
    for drift_m_s, repeated in zip(drifts_m_s, (False, True), strict=True):
        drift = np.concatenate((np.zeros(50), 0.1 * drift_m_s * np.arange(100), np.full(50, 10.0 * drift_m_s)))
        estimate = np.concatenate((drives, np.full(100, drives[-1]), after))
        assert repeats_pose(frames(along_x(estimate), along_x(estimate + drift))).any() == repeated


def test_the_scatter_of_a_truth_is_that_of_its_noise() -> None:
    assert scatter_m(TRUE) == pytest.approx(0.0, abs=1e-12)
    assert scatter_m(TRUE[:2]) == 0.0
    noisy = TRUE + np.random.default_rng(3).normal(0.0, 1e-3, (COUNT, 3))
    assert scatter_m(noisy) == pytest.approx(1e-3 * np.sqrt(6.0) * 1.54, rel=0.1)


def test_a_motion_is_that_of_the_truth_to_10_um_a_metre() -> None:
    growing = np.arange(COUNT)[:, None] * [1.0, 0.0, 0.0]
    assert counted(TRUE + 0.9e-6 * growing, TRUE) == (0, COUNT - 2), "the first step is shorter than 0.17 m"
    assert counted(TRUE + 1.1e-6 * growing, TRUE) == (0, 0)
    assert counted(TRUE + NOISE, TRUE) == (0, 0)


CURVED = np.column_stack((TRUE[:, 0] * 0.987654321, np.sin(TRUE[:, 0]), np.cos(TRUE[:, 0])))


def test_rounded_truths_count_in_rows_of_fifty() -> None:
    curved = CURVED
    for digits, many in ((2, COUNT - 1), (3, COUNT - 1), (5, COUNT - 1), (6, COUNT - 1)):
        assert counted(np.round(curved, digits), curved)[1] == many
    assert resolution_of(np.round(curved, 4)) == 1e-4
    assert resolution_of(curved) == 0.0
    for length, many in ((49, 0), (50, 50)):
        part = np.round(curved + NOISE, 3)
        part[100 : 100 + length] = np.round(curved[100 : 100 + length], 3)
        part[[99, 100 + length]] += 0.01
        assert counted(part, curved)[1] == many


@pytest.mark.parametrize(
    ("digits", "count", "testable"),
    [(3, COUNT, COUNT - 1), (2, COUNT, COUNT - 1), (1, COUNT, 0), (3, 50, 0), (6, 50, 48), (3, 52, 51)],
)
def test_copies_are_unknown_if_the_drive_is_too_short_for_the_resolution(
    digits: int, count: int, testable: int
) -> None:
    """A drive of 28 m, or its first poses. 50 moving poses in a row are required, on 2000 units of the resolution."""
    position = np.round(1.01 * CURVED[:count], digits)
    none = np.zeros(count, np.bool_)
    made = Frames(STAMPS[:count], CURVED[:count], LEVEL[:count], position, LEVEL[:count], np.arange(count))
    truth = Trajectory(STAMPS[:count], CURVED[:count], LEVEL[:count])
    row = Score(figures=tuple(copy_rows(made, truth, none, interpolated=False))).figure("poses_of_truth")
    assert (row.n, row.value) == (testable, 0.0 if testable else None)
    motions = judged_of_truth(made, [(np.array([0]), np.array([count - 1]))])
    assert (motions.n, motions.value) == ((1, 0.0) if digits == 6 else (0, None))


def test_steps_of_a_rover_that_stands_say_nothing() -> None:
    places = np.append(np.zeros(100), 0.1 * np.arange(1, 101))
    assert moving_steps(along_x(places)).sum() == 100
    creeping = np.append(0.009 * np.arange(80), 0.711 + 0.1 * np.arange(1, 121))
    assert moving_steps(along_x(creeping)).sum() == 120
    stationary = Score(
        figures=tuple(
            copy_rows(
                frames(TRUE, along_x(np.zeros(COUNT))),
                Trajectory(STAMPS, TRUE, LEVEL),
                np.zeros(COUNT, np.bool_),
                interpolated=False,
            )
        )
    )
    assert stationary.number("poses_of_truth") is None


def test_a_slow_drive_in_millimetres_is_no_copy() -> None:
    """30 Hz and 3 cm/s with a drift of 0.01 %: over some centimetres an honest estimate rounds to the truth."""
    slow = along_x(0.000987654321 * np.arange(COUNT))
    assert counted(np.round(slow * 1.0001, 3), slow) == (0, 0)
    fast = 20.0 * slow
    assert counted(np.round(fast, 3), fast)[1] > 0.9 * COUNT, "over 4 m the rounded truth is not an estimate"


@pytest.mark.parametrize("digits", [1, 2, 3, 4, 5, 12])
@pytest.mark.parametrize("rate_hz", [10.0, 50.0])
def test_short_steps_of_an_honest_estimate_are_not_those_of_the_truth(rate_hz: float, digits: int) -> None:
    """60 m at 6 cm/s: steps of 0.6 to 6 mm are rounded to those of the truth, whose file has the same decimals."""
    count = round(rate_hz * 1000.0)
    heading = np.linspace(0.0, 2.0, count)
    steps = 0.06 / rate_hz * np.column_stack((np.cos(heading), np.sin(heading), 0.2 * np.sin(8.0 * heading)))
    drift = np.radians(0.1) * 0.06 / rate_hz * np.arange(count)
    drifted = 0.06 / rate_hz * np.column_stack((np.cos(heading + drift), np.sin(heading + drift)))
    drifted = np.column_stack((drifted, steps[:, 2]))
    true = np.round(np.cumsum(steps, axis=0), digits)
    level = np.tile([0.0, 0.0, 0.0, 1.0], (count, 1))
    stamps_ns = np.round(np.arange(count) * 1e9 / rate_hz).astype(np.int64)
    for estimated in (1.001 * steps, 1.0001 * steps, drifted):
        position = np.round(np.cumsum(estimated, axis=0), digits)
        made = Frames(stamps_ns, true, level, position, level, np.arange(count))
        none = np.zeros(count, np.bool_)
        rows = Score(figures=tuple(copy_rows(made, Trajectory(stamps_ns, true, level), none, interpolated=False)))
        assert (rows.number("poses_of_truth") or 0.0) < 0.05
        frames_of_1_s = round(rate_hz)
        starts = np.arange(0, count - frames_of_1_s, frames_of_1_s)
        assert (judged_of_truth(made, [(starts, starts + frames_of_1_s)]).value or 0.0) < 0.05


def test_sub_trajectories_in_which_the_rover_hardly_moves_are_no_evidence_of_copied_errors() -> None:
    """The estimate is exact while the rover creeps by 0.2 m in ten frames, and drifts while it moves by 10 m."""
    true = along_x(np.append(0.02 * np.arange(100), 2.0 + np.arange(100)))
    drifting = true + np.where(np.arange(COUNT)[:, None] < 100, 0.0, NOISE)
    starts = np.append(np.arange(0, 80, 10), np.arange(100, 180, 10))
    row = judged_of_truth(frames(drifting, true), [(starts, starts + 10)])
    assert (row.n, row.value) == (8, 0.0)
