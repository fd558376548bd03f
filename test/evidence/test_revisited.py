"""Misclosure at revisited places: a rover that drives back over its own path, with images of noise."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from helpers.loc_drive import noisy
from helpers.made_scene import LOC_RIG, PERIOD_NS, START_NS, T_RB_LOCSB, stereo_pair, true_pose
from sfr_loc_map.evidence.agreement import Agreement
from sfr_loc_map.evidence.check import check_drive
from sfr_loc_map.evidence.check_result import CheckResult, results_of_probabilities
from sfr_loc_map.evidence.check_tables import AGREEMENT_TABLE, REVISITED_TABLE
from sfr_loc_map.evidence.localiser_runs import ComparedRun, PairsInMemory, RunVariant, run_pairs, run_variant
from sfr_loc_map.evidence.revisited import Closure, agreement_at, closure_between, find_closures, worth_of_visits
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.metrics.conditions import Condition
from sfr_loc_map.metrics.frames.association import Estimates
from sfr_loc_map.metrics.frames.covariance import STEP_SIZE, UPPER
from sfr_loc_map.metrics.score.score import Score

STEPS = 60  #: Steps around a made circle.
OUT = 30  #: Pairs of the way out.
OFFSET_M = [0.0, 0.02, 0.01]  #: Of the way back from the way out, so that no image repeats another.
CONFIG = LocalisationConfig()


def result_of(agreement: Agreement) -> CheckResult:
    (result,) = results_of_probabilities([agreement.probability])
    return result


@cache
def there_and_back() -> PairsInMemory:
    """Return a drive of 1.45 m that returns to its start."""
    rng = np.random.default_rng(1)
    pairs = []
    for number, index in enumerate([*range(OUT), *range(OUT - 2, -1, -1)]):
        pose = true_pose(index)
        if number >= OUT:
            pose = Transform(pose.rotation, pose.translation + OFFSET_M)
        pair = stereo_pair(START_NS + number * PERIOD_NS, pose @ T_RB_LOCSB, LOC_RIG)
        pairs.append(StereoPair(pair.stamp_ns, noisy(pair.left, 2.0, rng), noisy(pair.right, 2.0, rng)))
    return PairsInMemory(LOC_RIG, pairs)


@cache
def forward() -> ComparedRun:
    """Return the run of the drive as it is."""
    return run_variant(there_and_back(), CONFIG, RunVariant.FORWARD, lambda: None)


def drifted(run: ComparedRun, drift_m: float) -> ComparedRun:
    """Return a run that drifts sideways by so much from its first to its last pose, which it does not state."""
    poses = run.estimates.trajectory
    drift = np.linspace(0.0, drift_m, len(poses))[:, None] * [0.0, 1.0, 0.0]
    return replace(run, estimates=replace(run.estimates, trajectory=replace(poses, positions=poses.positions + drift)))


def test_a_place_is_found_and_the_drive_returns_to_it() -> None:
    closures = find_closures(there_and_back(), forward(), CONFIG)
    assert [(item.first, item.again) for item in closures] == [(0, 58)], "one place: all others share its path"
    (closure,) = closures
    assert closure.path_m == pytest.approx(1.45, abs=0.02)
    assert 0.0 < closure.misclosure_m < 0.01
    assert closure.square is not None
    assert closure.square < 16.8, "99 % of consistent covariances"
    assert result_of(agreement_at(closures)) is CheckResult.CONSISTENT


def test_the_direct_run_measures_the_true_motion_between_both_visits() -> None:
    drive = there_and_back()
    direct = run_pairs(drive, CONFIG, "direct", [drive.kept[0], drive.kept[58]])
    move = np.diff(direct.estimates.trajectory.positions, axis=0)[0]
    expected = true_pose(0).rotation.T @ OFFSET_M
    assert move == pytest.approx(expected, abs=0.004)


def test_a_drift_that_is_not_stated_is_found_and_measured() -> None:
    drive = there_and_back()
    direct = run_pairs(drive, CONFIG, "direct", [drive.kept[0], drive.kept[58]])
    usual = closure_between(forward(), direct, 0, 58)
    found = closure_between(drifted(forward(), 0.2), direct, 0, 58)
    assert usual is not None
    assert found is not None
    assert found.error[1] - usual.error[1] == pytest.approx(0.2)
    assert found.square is not None
    assert result_of(agreement_at([found])) is CheckResult.INCONSISTENT


def test_a_direct_run_that_is_not_trusted_gives_no_misclosure() -> None:
    """The second visit shows black images, so that the direct run is lost there."""
    drive = there_and_back()
    black = replace(drive.kept[58], left=np.zeros_like(drive.kept[58].left), right=np.zeros_like(drive.kept[58].right))
    direct = run_pairs(drive, CONFIG, "direct", [drive.kept[0], black])
    assert closure_between(forward(), direct, 0, 58) is None


def test_a_way_that_does_not_return_and_a_lost_pose_show_no_place() -> None:
    out = PairsInMemory(LOC_RIG, there_and_back().kept[:OUT])
    assert find_closures(out, run_variant(out, CONFIG, RunVariant.FORWARD, lambda: None), CONFIG) == []
    lost = np.ones(len(forward().estimates.trajectory), np.bool_)
    nowhere = replace(forward(), estimates=replace(forward().estimates, lost=lost))
    assert not worth_of_visits(nowhere).any()
    assert worth_of_visits(forward()).any()


def test_the_check_has_the_places_in_its_figures_and_tables() -> None:
    found = check_drive(there_and_back(), CONFIG, [Condition.parse("frames=5")], 100)
    score = Score(figures=found.figures)
    part = "pairs 0 and 58"
    path_m = score.number("revisited_path", "value", part=part)
    misclosure_m = score.number("misclosure", "value", part=part)
    assert score.number("misclosure_of_path", "value", part=part) == pytest.approx(misclosure_m / path_m)
    assert score.number("error_at_least", "value", part="forward - direct") == pytest.approx(0.5 * misclosure_m)
    over = {row[0].text: row[1].text for row in AGREEMENT_TABLE.of(found.figures).rows}
    assert over["forward - direct"] == "revisited places"
    (row,) = REVISITED_TABLE.of(found.figures).rows
    assert [cell.value for cell in row[1:]] == pytest.approx(
        [path_m, None, misclosure_m, misclosure_m / path_m, score.number("misclosure_nees", "value", part=part)]
    )


def circle(seed: int, steps: int, step_sigmas: tuple[float, float], heading: float) -> ComparedRun:
    """Return a run around a circle whose steps have errors of the sigmas that they state, m and rad."""
    rng = np.random.default_rng(seed)
    turn = Rotation.from_rotvec([0.0, 0.0, 2.0 * np.pi / STEPS * (STEPS // steps)])
    attitude, position = Rotation.from_rotvec([0.0, 0.0, heading]), np.zeros(3)
    move = np.array([0.1, 0.0, 0.0]) if steps == STEPS else np.zeros(3)  # the direct run returns in one step
    positions, quats = [position], [attitude.as_quat()]
    for _ in range(steps):
        position = position + attitude.apply(move + rng.normal(0.0, step_sigmas[0], 3))
        attitude = attitude * turn * Rotation.from_rotvec(rng.normal(0.0, step_sigmas[1], 3))
        positions.append(position)
        quats.append(attitude.as_quat())
    stamps = 1_000_000_000 + np.arange(STEPS + 1) * PERIOD_NS
    stated = np.zeros((steps + 1, STEP_SIZE))
    stated[:, :21] = np.diag([step_sigmas[0] ** 2] * 3 + [step_sigmas[1] ** 2] * 3)[UPPER]
    chosen = stamps if steps == STEPS else stamps[[0, -1]]
    poses = Trajectory(chosen, np.array(positions), np.array(quats))
    return ComparedRun("made", Estimates.of(poses, steps=stated))


def test_misclosures_are_as_large_as_consistent_covariances_predict() -> None:
    """100 circles: NEES has the mean 6, and the probability is below 5 % in 5 % of the circles."""
    squares, alarms = [], 0
    for seed in range(100):
        forward_run = circle(seed, STEPS, (1e-3, 4e-4), heading=0.3)
        direct = circle(1000 + seed, 1, (2e-3, 1e-3), heading=2.0)
        closure = closure_between(forward_run, direct, 0, STEPS)
        assert closure is not None
        assert closure.square is not None
        squares.append(closure.square)
        alarms += result_of(agreement_at([closure])) is CheckResult.INCONSISTENT
    assert np.mean(squares) == pytest.approx(6.0, abs=4 * np.sqrt(12.0 / 100))
    assert 1 <= alarms <= 14, "5 are expected"


@pytest.mark.parametrize("flaw", ["lost pose", "shrunken covariance"])
def test_a_path_without_a_usable_covariance_has_a_misclosure_without_a_square(flaw: str) -> None:
    forward_run, direct = circle(0, STEPS, (1e-3, 4e-4), heading=0.3), circle(1, 1, (2e-3, 1e-3), heading=2.0)
    estimates, steps = forward_run.estimates, forward_run.estimates.steps
    assert steps is not None
    lost = estimates.lost.copy()
    if flaw == "lost pose":
        lost[STEPS // 2] = True
    else:
        steps = -100.0 * steps
    closure = closure_between(
        replace(forward_run, estimates=replace(estimates, steps=steps, lost=lost)), direct, 0, STEPS
    )
    assert closure is not None
    assert closure.square is None


def test_the_law_of_several_places_adds_their_squares() -> None:
    """Six squares of 6 are usual; a place without a covariance counts in the difference alone."""
    places = [Closure(0, 10, 2.0, np.full(6, 0.01), 6.0)] * 6 + [Closure(20, 40, 2.0, np.full(6, 0.01), None)]
    found = agreement_at(places)
    assert len(found.position_m) == 7
    assert len(found.squares) == 6
    assert found.probability == pytest.approx(0.47, abs=0.01)
