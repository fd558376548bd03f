"""Runs that should agree: differences whose law is known, in both directions of time; the three-cornered hat."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from sfr_loc_map.errors import InputError, MetricsError
from sfr_loc_map.evidence.agreement import Agreement, compare, disagreement_of, shortage_of
from sfr_loc_map.evidence.calibration import Advice, CameraOffset, offset_rows, right_camera_offsets
from sfr_loc_map.evidence.check_result import (
    DRIVE,
    MAPS,
    Check,
    CheckResult,
    combined,
    joined,
    results_of_probabilities,
)
from sfr_loc_map.evidence.check_tables import calibration_table
from sfr_loc_map.evidence.localiser_runs import ComparedRun
from sfr_loc_map.evidence.other_estimates import at_pairs_of, check_different, hat_rows, scale_row, three_cornered_hat
from sfr_loc_map.evidence.overlap import Overlap, overlap_rows
from sfr_loc_map.evidence.paired_runs import paired, rows_at
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.localisation.estimate import TrackingStatistics
from sfr_loc_map.metrics.conditions import Condition
from sfr_loc_map.metrics.figures.rows import figure_row
from sfr_loc_map.metrics.frames.association import Estimates
from sfr_loc_map.metrics.frames.covariance import STEP_SIZE, UPPER

STAMPS = 1_000_000_000 + np.arange(400) * 100_000_000
SIGMA_M, SIGMA_RAD = 1e-3, 2e-4
CONDITION = Condition.parse("distance=2")


def true_steps(rng: np.random.Generator) -> tuple[Rotation, np.ndarray]:
    """Motions of 0.1 m that wind."""
    turns = Rotation.from_rotvec(rng.normal(0, 0.03, (len(STAMPS) - 1, 3)))
    return turns, np.tile([0.1, 0.0, 0.0], (len(STAMPS) - 1, 1))


def run_of(
    name: str, turns: Rotation, moves: np.ndarray, seed: int, *, is_backward: bool = False, drift_m: float = 0.0
) -> ComparedRun:
    """A run whose steps have errors of the covariance that it states, and of a drift that it does not."""
    rng = np.random.default_rng(seed)
    moves = moves + rng.normal(0, SIGMA_M, moves.shape) + [0.0, drift_m, 0.0]
    turns = turns * Rotation.from_rotvec(rng.normal(0, SIGMA_RAD, (len(moves), 3)))
    attitude, position = Rotation.from_rotvec([0.0, 0.0, float(seed)]), np.zeros(3)
    positions, quats = [position], [attitude.as_quat()]
    for turn, move in zip(turns, moves, strict=True):
        position = position + attitude.apply(move)
        attitude = attitude * turn
        positions.append(position)
        quats.append(attitude.as_quat())
    steps = np.zeros((len(STAMPS), STEP_SIZE))
    steps[:, :21] = np.diag([SIGMA_M**2] * 3 + [SIGMA_RAD**2] * 3)[UPPER]
    steps[:, 21:27] = 0.1  # what all steps share is left out, whatever its size
    trajectory = Trajectory(STAMPS, np.array(positions), np.array(quats))
    covariance = np.tile((1e-6 * np.eye(6))[UPPER], (len(STAMPS), 1))
    return ComparedRun(
        name, Estimates.of(trajectory, covariance=covariance, steps=steps), (), STAMPS[::-1] if is_backward else None
    )


def result_of(*agreements: Agreement) -> CheckResult:
    return combined(results_of_probabilities([item.probability for item in agreements]))


def reversed_steps(turns: Rotation, moves: np.ndarray) -> tuple[Rotation, np.ndarray]:
    """The motions in reverse order and direction."""
    inverse = turns.inv()
    return inverse[::-1], -inverse.apply(moves)[::-1]


@pytest.mark.parametrize("backward", [False, True])
def test_independent_runs_differ_as_their_covariances_predict(backward: bool) -> None:
    rng = np.random.default_rng(0)
    squares = []
    for seed in range(12):
        turns, moves = true_steps(rng)
        first = run_of("a", turns, moves, 2 * seed)
        steps = reversed_steps(turns, moves) if backward else (turns, moves)
        other = run_of("b", *steps, 2 * seed + 1, is_backward=backward)
        found = compare(first, other, CONDITION)
        squares.append(found.squares)
        assert len(found.squares) >= 12
    mean = np.concatenate(squares).mean()
    assert mean == pytest.approx(6.0, abs=4 * np.sqrt(12.0 / len(np.concatenate(squares))))


def test_the_first_run_ends_the_sub_trajectories() -> None:
    """A condition on the rotation is met by the first run alone: the other run has a constant attitude."""
    turning = Rotation.from_rotvec(np.tile([0.0, 0.0, 0.02], (len(STAMPS) - 1, 1)))
    moves = np.tile([0.1, 0.0, 0.0], (len(STAMPS) - 1, 1))
    first, other = run_of("a", turning, moves, 1), run_of("b", Rotation.identity(len(moves)), moves, 2)
    condition = Condition.parse("turn=30")
    assert len(compare(first, other, condition).position_m) > 50
    assert len(compare(other, first, condition).position_m) == 0


def test_a_drift_that_is_not_stated_is_found_and_bounds_the_error() -> None:
    turns, moves = true_steps(np.random.default_rng(1))
    first, other = run_of("a", turns, moves, 1), run_of("b", turns, moves, 2)
    drifting = run_of("c", turns, moves, 3, drift_m=2e-3)
    agreeing, differing = compare(first, other, CONDITION), compare(first, drifting, CONDITION)
    assert result_of(agreeing) is CheckResult.CONSISTENT
    assert result_of(agreeing, differing) is CheckResult.INCONSISTENT
    sizes = np.linalg.norm(differing.position_m, axis=1)
    assert 0.5 * np.sqrt(np.mean(sizes**2)) < 20 * 2e-3 * 1.2, "no more than the drift over 20 steps"
    assert np.mean(sizes) > 0.6 * 20 * 2e-3


def test_the_scale_against_wheels_shows_a_wrong_baseline() -> None:
    turns, moves = true_steps(np.random.default_rng(1))
    stereo, wheels = run_of("stereo", turns, 1.005 * moves, 1), run_of("wheels", turns, moves, 2)
    row = scale_row(stereo, wheels, CONDITION)
    assert row.low95 < 0.005 < row.high95
    assert row.low95 > 0.0, "the scale is significant"
    assert scale_row(stereo, wheels, Condition.parse("distance=39")).value is None


def test_an_estimate_at_another_rate_is_interpolated_to_the_pairs() -> None:
    """The poses of the wheels at 50 Hz have stamps 3 ms beside those of the pairs."""
    turns, moves = true_steps(np.random.default_rng(1))
    stereo = run_of("stereo", turns, moves, 1)
    poses = stereo.estimates.trajectory
    stamps = np.arange(STAMPS[0] - 17_000_000, STAMPS[-1] + 20_000_000, 20_000_000)
    inside = np.clip(stamps, STAMPS[0], STAMPS[-1])
    x, y, z = (np.interp(inside, STAMPS, axis) for axis in poses.positions.T)
    quats = Slerp(STAMPS, Rotation.from_quat(poses.quats_xyzw))(inside).as_quat()
    wheels = ComparedRun("wheels", Estimates.of(Trajectory(stamps, np.column_stack((x, y, z)), quats)))
    position_m = compare(stereo, at_pairs_of(stereo, wheels), CONDITION).position_m
    assert len(position_m) > 60
    assert np.abs(position_m).max() < 0.01, "the interpolation cuts a corner of 0.1 m by a few millimetres"


def test_an_estimate_of_another_clock_or_without_attitudes_is_refused() -> None:
    stereo = run_of("stereo", *true_steps(np.random.default_rng(1)), 1)
    poses = stereo.estimates.trajectory
    other_clock = ComparedRun("wheels", Estimates.of(replace(poses, stamps_ns=poses.stamps_ns + 10**12)))
    with pytest.raises(InputError, match="fewer than two poses"):
        at_pairs_of(stereo, other_clock)
    positions = ComparedRun("wheels", Estimates.of(replace(poses, quats_xyzw=np.zeros((len(poses), 4)))))
    with pytest.raises(InputError, match="only positions"):
        at_pairs_of(stereo, positions)


def test_a_covariance_that_is_not_positive_definite_gives_no_square() -> None:
    turns, moves = true_steps(np.random.default_rng(1))
    first, other = run_of("a", turns, moves, 1), run_of("b", turns, moves, 2)
    steps = other.estimates.steps
    assert steps is not None
    shrunken = replace(other, estimates=replace(other.estimates, steps=-9.0 * steps))
    found = compare(first, shrunken, CONDITION)
    assert len(found.position_m) > 60
    assert len(found.squares) == 0


def test_too_few_sub_trajectories_are_not_enough_data() -> None:
    turns, moves = true_steps(np.random.default_rng(1))
    runs = run_of("a", turns, moves, 1), run_of("b", turns, moves, 2)
    far = compare(*runs, Condition.parse("distance=30"))
    assert far.probability is None
    assert result_of(far) is CheckResult.NOT_ENOUGH_DATA
    assert "shorter --condition" in shortage_of([far])


@pytest.mark.parametrize("state", ["lost", "degraded"])
def test_a_pose_that_is_not_tracked_predicts_no_difference(state: str) -> None:
    """A quarter of the drive has such poses between the frames: the other run has every second pair only."""
    turns, moves = true_steps(np.random.default_rng(1))
    first, other = run_of("a", turns, moves, 1), run_of("b", turns, moves, 2)
    poses, steps = other.estimates.trajectory, other.estimates.steps
    assert steps is not None
    half = Trajectory(poses.stamps_ns[::2], poses.positions[::2], poses.quats_xyzw[::2])
    second = ComparedRun("b", Estimates.of(half, steps=steps[::2]))
    usual = compare(first, second, CONDITION)
    flags = np.zeros(len(STAMPS), np.bool_)
    flags[151:251:2] = True
    marked = replace(first, estimates=replace(first.estimates, **{state: flags}))
    found = compare(marked, second, CONDITION)
    assert len(found.position_m) == len(usual.position_m)
    assert len(usual.squares) - len(found.squares) in (3, 4, 5)
    nowhere = replace(first, estimates=replace(first.estimates, **{state: np.ones_like(flags)}))
    never = compare(nowhere, second, CONDITION)
    assert never.probability is None
    assert state in shortage_of([never])


def test_an_undefined_probability_is_not_enough_data() -> None:
    results = results_of_probabilities([float("nan"), 0.02, None])
    assert results == (CheckResult.NOT_ENOUGH_DATA, CheckResult.INCONSISTENT, CheckResult.NOT_ENOUGH_DATA)


def test_runs_are_paired_by_exact_stamps_alone() -> None:
    turns, moves = true_steps(np.random.default_rng(1))
    first, other = run_of("a", turns, moves, 1), run_of("b", turns, moves, 2)
    poses = other.estimates.trajectory
    late = replace(poses, stamps_ns=poses.stamps_ns + np.where(np.arange(len(STAMPS)) % 2, 1, 0))
    runs = paired(first, replace(other, estimates=Estimates.of(late)))
    assert runs.ours.rows.tolist() == runs.theirs.rows.tolist() == list(range(0, len(STAMPS), 2))
    with pytest.raises(MetricsError, match="no pose at stamp"):
        rows_at(first, STAMPS[:3] + np.array([0, 1, 0]))


def test_an_estimate_with_the_motions_of_a_run_is_refused() -> None:
    """The motions are the same from another start pose."""
    turns, moves = true_steps(np.random.default_rng(1))
    first, other = run_of("a", turns, moves, 1), run_of("b", turns, moves, 2)
    poses = first.estimates.trajectory
    turned = Rotation.from_rotvec([0.1, 0.0, 2.0])
    quats = (turned * Rotation.from_quat(poses.quats_xyzw)).as_quat()
    moved = Trajectory(STAMPS, turned.apply(poses.positions) + np.array([1.0, 2.0, 3.0]), quats)
    check_different(first, other)
    with pytest.raises(InputError, match="same poses"):
        check_different(first, ComparedRun("copy.csv", Estimates.of(moved)))


def test_the_hat_requires_three_independent_sub_trajectories() -> None:
    turns, moves = true_steps(np.random.default_rng(1))
    runs = [run_of(name, turns, moves, seed) for seed, name in enumerate("abc")]
    rows = hat_rows(runs, Condition.parse("distance=30"))
    assert [row.value for row in rows] == [None] * 3
    assert rows[0].n is not None
    assert rows[0].n > 1


def test_false_findings_are_as_rare_as_stated() -> None:
    """p is uniform where covariances hold: of 30 pairs of runs, 5 % would have a finding."""
    rng = np.random.default_rng(5)
    found = []
    for seed in range(30):
        turns, moves = true_steps(rng)
        runs = run_of("a", turns, moves, 1000 + seed), run_of("b", turns, moves, 2000 + seed)
        found.append(result_of(compare(*runs, CONDITION)) is CheckResult.INCONSISTENT)
    assert np.mean(found) < 0.05 + 3 * np.sqrt(0.05 * 0.95 / 30)


def test_the_hat_gives_each_sigma_and_refuses_what_it_cannot() -> None:
    rng = np.random.default_rng(3)
    a, b, c = (rng.normal(0, sigma, (4000, 3)) for sigma in (1.0, 2.0, 3.0))
    found = three_cornered_hat(a - b, a - c, b - c)
    assert found == pytest.approx([np.sqrt(3), 2 * np.sqrt(3), 3 * np.sqrt(3)], rel=0.1)
    shared = rng.normal(0, 5.0, (4000, 3))
    hidden = three_cornered_hat((a + shared) - (b + shared), a - c, b - c)
    assert hidden == pytest.approx(found), "what is shared stays hidden"
    assert three_cornered_hat(a * 0.1, a, a * 0.1) is None


def test_the_hat_compares_the_same_sub_trajectories_of_all_three() -> None:
    """Half of the second run is missing: the sigma of the others is that of the same half."""
    rng = np.random.default_rng(4)
    turns, moves = true_steps(rng)
    runs = [run_of(name, turns, moves, seed) for seed, name in enumerate("abc")]
    half = Trajectory(*(column[:200] for column in (STAMPS, *poses_of(runs[1]))))
    halves = [
        replace(run, estimates=Estimates.of(Trajectory(*(c[:200] for c in (STAMPS, *poses_of(run)))))) for run in runs
    ]
    mixed = hat_rows([runs[0], ComparedRun("b", Estimates.of(half)), runs[2]], CONDITION)
    expected = hat_rows(halves, CONDITION)
    assert [(row.n, row.value) for row in mixed] == [(row.n, row.value) for row in expected]


def poses_of(run: ComparedRun) -> tuple[np.ndarray, np.ndarray]:
    return run.estimates.trajectory.positions, run.estimates.trajectory.quats_xyzw


def test_a_right_camera_that_is_off_is_named_with_its_cost() -> None:
    rig = StereoRig(512, 512, 400.0, 400.0, 255.5, 255.5, 0.12)

    def run(vertical: float, yaw: float) -> ComparedRun:
        turns, moves = true_steps(np.random.default_rng(1))
        statistics = [TrackingStatistics()] * 10
        statistics += [TrackingStatistics(vertical_offset_px=vertical, disparity_offset_px=yaw)] * 20
        return replace(run_of("a", turns, moves, 1), statistics=tuple(statistics))

    runs = [run(0.01, 0.70), run(-0.02, 0.68), run(0.01, 0.72), run(0.0, 0.69)]
    pitch, yaw = right_camera_offsets(runs, rig)
    assert (pitch.angle, pitch.is_wrong, yaw.angle, yaw.is_wrong) == ("pitch", False, "yaw", True)
    assert yaw.px == pytest.approx(0.6975)
    assert yaw.degrees == pytest.approx(0.1, abs=0.002)
    assert yaw.depth_error_m == pytest.approx(16 * 0.6975 / 48.0)
    assert "yaw" in yaw.text
    assert not right_camera_offsets([run(0.0, 1.0), run(0.0, -1.0)], rig)[1].is_wrong, "runs that disagree show nothing"
    advice = {offset.angle: offset.advice for offset in (pitch, yaw)}
    figures = [row for offset in (pitch, yaw) for row in offset_rows(offset)]
    assert [row[-1].text for row in calibration_table(figures, advice).rows] == ["keep", "-", "redo", "-", "-"]
    spreads = [row.value for row in figures if row.figure == "right_camera_spread"]
    assert spreads == pytest.approx([0.03, 0.04])
    assert not any(row.interval for row in figures), "runs that share their images have no confidence interval"
    stored = calibration_table(figures, {"pitch": Advice.UNCLEAR})
    assert [row[-1].text for row in stored.rows] == ["unclear", *"----"], "the stored advice is shown"


@pytest.mark.parametrize(
    ("px", "extremes", "advice"),
    [
        (0.3, (0.1, 0.5), "redo"),
        (-0.3, (-0.5, -0.1), "redo"),
        (0.1, (0.05, 0.15), "keep"),
        (0.0, (-0.1, 0.1), "keep"),
        (0.1, (0.05, 0.25), "unclear"),
        (-0.1, (-0.25, 0.05), "unclear"),
        (0.3, (-0.1, 0.7), "unclear"),
    ],
)
def test_the_advice_follows_from_all_runs(px: float, extremes: tuple[float, float], advice: str) -> None:
    assert CameraOffset("pitch", 4, px, *extremes, degrees=0.1).advice == advice
    assert CameraOffset("yaw", 4, px, *extremes, degrees=0.1).advice == ("redo" if advice == "redo" else "unclear")


@pytest.mark.parametrize(
    ("drive", "maps", "overall"),
    [
        ("consistent", "consistent", "consistent"),
        ("consistent", "not enough data", "not enough data"),
        ("inconsistent", "not enough data", "inconsistent"),
    ],
)
def test_a_recording_is_consistent_only_if_each_of_its_subjects_is(drive: str, maps: str, overall: str) -> None:
    probability = {"consistent": 0.5, "inconsistent": 0.0}[drive]
    points = {"consistent": 5000, "not enough data": 10}[maps]
    of_drive = figure_row("agreement", "distance=1", "forward - backward", n=3, value=probability)
    of_other = figure_row("agreement", "distance=1", "forward - wheels.csv", n=3, value=0.0)

    of_maps = Check(
        figures=tuple(overlap_rows(Overlap(0, 1, 0.4, points, 0.01, 1.0, 0.2))),
        pairs={MAPS: 2},
        pairs_of_source={MAPS: 2},
        not_checked=("too short",) if maps == "not enough data" else (),
    )

    def recording(**advice: Advice) -> Check:
        disagreements = ("why",) if drive == "inconsistent" else ()
        figures = (of_drive, of_other)
        pairs = {DRIVE: 30}
        of_sequence = Check(
            figures=figures, pairs=pairs, pairs_of_source=pairs, disagreements=disagreements, advice=advice
        )
        return joined([of_sequence, of_maps])

    content = recording().to_dict()
    assert content["result"] == overall
    assert content["not_checked"] == (["too short"] if maps == "not enough data" else [])
    assert content["disagreements"] == (["why"] if drive == "inconsistent" else [])
    redo = recording(pitch=Advice.REDO).to_dict()
    assert redo["result"] == redo["results"]["calibration"] == "inconsistent"


def test_the_finding_is_named_beside_a_comparison_with_an_undefined_probability() -> None:
    rng = np.random.default_rng(0)
    turns, moves = true_steps(rng)
    found = compare(run_of("a", turns, moves, 0), run_of("b", turns, moves, 1), CONDITION)
    undefined = replace(found, runs=("c", "d"), squares=np.full(3, np.nan))
    assert "'a' and 'b'" in disagreement_of([undefined, replace(found, squares=np.full(3, 30.0))])
