"""Scores by a truth of positions alone, and by one with noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from helpers.random_drives import as_score
from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.trajectory import Trajectory, Truth
from sfr_loc_map.metrics.conditions import Condition
from sfr_loc_map.metrics.config import AlignedErrorConfig, AssociationConfig, Reading, TrajectoryScoreConfig
from sfr_loc_map.metrics.conventions.convention_diagnosis import diagnose
from sfr_loc_map.metrics.frames.association import Estimates
from sfr_loc_map.metrics.frames.covariance import UPPER
from sfr_loc_map.metrics.judging.judge import judged_by
from sfr_loc_map.metrics.judging.limits_file import parse_limits
from sfr_loc_map.metrics.judging.reasons import conditions_beyond
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.stored.score_json import from_json, to_json
from sfr_loc_map.metrics.trajectory.aligned_error import aligned_errors
from sfr_loc_map.metrics.trajectory.trajectory_score import score_trajectory

CONFIG = TrajectoryScoreConfig(("distance=2", "time=5"), spacing=5)
COUNT = 400
STAMPS = np.arange(COUNT) * 100_000_000


def drive(seed: int = 1) -> tuple[Trajectory, Trajectory]:
    """Return a curved drive and an estimate that drifts, in a frame of its own."""
    rng = np.random.default_rng(seed)
    s = np.linspace(0.0, 20.0, COUNT)
    positions = np.column_stack((s, 2.0 * np.sin(0.5 * s), 0.2 * np.sin(s)))
    turns = Rotation.from_euler("ZYX", np.column_stack((np.arctan(np.cos(0.5 * s)), 0.1 * np.sin(s), 0.05 * np.cos(s))))
    drift = np.cumsum(rng.normal(0.0, 2e-3, (COUNT, 3)), axis=0)
    turned = Rotation.from_rotvec(np.cumsum(rng.normal(0.0, 1e-4, (COUNT, 3)), axis=0)) * turns
    return Trajectory(STAMPS, positions, turns.as_quat()), Trajectory(STAMPS, positions + drift, turned.as_quat())


def alone(truth: Trajectory, lever: tuple[float, ...] = (0.0, 0.0, 0.0), **more: float) -> Truth:
    """Return the positions of a point of RB, without attitudes."""
    moved = truth.positions + Rotation.from_quat(truth.quats_xyzw).apply(lever)
    return Truth(truth.stamps_ns, moved, np.zeros((len(truth), 4)), lever_arm_m=lever, **more)


def scored(estimate: Trajectory, truth: Trajectory) -> Score:
    return as_score(score_trajectory(Estimates.of(estimate), truth, CONFIG))


def total(score: Score) -> float:
    return score.number("position", "mean_plus_3sigma")


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 1000), st.floats(-180.0, 180.0), st.floats(-50.0, 50.0))
def test_positions_alone_keep_the_chords_and_know_no_yaw(seed: int, yaw_deg: float, offset: float) -> None:
    """Chords are those of the full score; yaw and place of the estimate's frame change nothing; attitude is unknown."""
    truth, estimate = drive(seed)
    turn = Rotation.from_euler("z", yaw_deg, degrees=True)
    elsewhere = Trajectory(
        STAMPS, turn.apply(estimate.positions) + offset, (turn * Rotation.from_quat(estimate.quats_xyzw)).as_quat()
    )
    full, plain, turned = scored(estimate, truth), scored(estimate, alone(truth)), scored(elsewhere, alone(truth))
    assert full.conditions == plain.conditions == turned.conditions
    assume(plain.association.reading is not Reading.ROTATION_ALIGNED)  # the drift of one seed in a thousand is a tilt
    assert plain.association.reading is Reading.YAW_ALIGNED
    assert {row.part for row in plain.rows("attitude")} & {"pose", "displacement", "position"} == set()
    assert not plain.rows("nees")
    for condition in full.conditions:
        whole, part, other = (each.figure("chord", condition=condition) for each in (full, plain, turned))
        position, moved = (each.figure("position", condition=condition) for each in (plain, turned))
        for name in ("mean", "sigma", "mean_plus_3sigma"):
            assert part.statistic(name) == pytest.approx(whole.statistic(name), abs=1e-9)
            assert other.statistic(name) == pytest.approx(part.statistic(name), abs=1e-9)
            assert moved.statistic(name) == pytest.approx(position.statistic(name), abs=1e-9)
            for unknown in ("attitude", "heading"):
                assert plain.number(unknown, name, condition=condition) is None
        assert part.n == whole.n > 10
        assert part.mean_plus_3sigma <= position.mean_plus_3sigma
    found = (turned.truth.yaw_deg - plain.truth.yaw_deg + yaw_deg + 180.0) % 360.0 - 180.0
    assert found == pytest.approx(0.0, abs=1e-6)


def test_the_position_error_after_a_fit_is_near_that_of_the_whole_pose() -> None:
    """On a drive whose heading hardly drifts; the chord is the direct formula."""
    truth, estimate = drive()
    assert total(scored(estimate, alone(truth))) == pytest.approx(total(scored(estimate, truth)), rel=0.1)
    rows = scored(estimate, truth).details.trajectory.sub_trajectories[0]
    starts, ends = np.array(rows.start_frame), np.array(rows.end_frame)
    chords = [np.linalg.norm(item.positions[ends] - item.positions[starts], axis=1) for item in (estimate, truth)]
    np.testing.assert_allclose(rows.chord_m, chords[0] - chords[1], atol=1e-8)


def test_an_estimate_that_begins_level_on_a_slope_is_fitted_with_its_tilt() -> None:
    """Vision alone does not know the vertical; a small drift is not a tilt, and a straight line has none."""
    truth, estimate = drive()
    tilt = Rotation.from_euler("ZYX", [40.0, 6.0, -3.0], degrees=True)
    tilted = Trajectory(
        STAMPS, tilt.apply(estimate.positions), (tilt * Rotation.from_quat(estimate.quats_xyzw)).as_quat()
    )
    plain, found = scored(estimate, alone(truth)), scored(tilted, alone(truth))
    assert (plain.association.reading, found.association.reading) == (Reading.YAW_ALIGNED, Reading.ROTATION_ALIGNED)
    assert plain.truth.tilt_deg is None
    assert found.truth.tilt_deg == pytest.approx(6.7, abs=0.5)
    assert total(found) <= 1.1 * total(plain)
    line = replace(truth, positions=truth.positions * [1.0, 0.0, 0.0])
    assert scored(line, alone(line)).association.reading is Reading.YAW_ALIGNED
    for noise_m in (0.0, 1e-3):  # what turns about the line is noise
        place = line.positions + np.random.default_rng(2).normal(0.0, noise_m, (COUNT, 3))
        sloped = replace(line, positions=Rotation.from_euler("ZY", [40.0, 6.0], degrees=True).apply(place))
        found = scored(sloped, alone(line))
        assert found.truth.tilt_deg == pytest.approx(6.0, abs=0.05)
        assert total(found) < 0.01 + 1e-6


def test_a_prism_is_compared_where_it_is() -> None:
    """The estimate is taken to the prism: a perfect one has no error there, and has one at RB."""
    truth, _ = drive()
    lever = (0.4, -0.3, 1.5)
    right = scored(truth, alone(truth, lever))
    assert total(right) == pytest.approx(0.0, abs=1e-9)
    assert right.truth.lever_arm_m == lever
    wrong = scored(truth, replace(alone(truth, lever), lever_arm_m=(0.0, 0.0, 0.0)))
    assert total(wrong) > 0.1


def test_a_straight_line_distance_requires_no_attitudes() -> None:
    truth, estimate = drive()
    config = replace(CONFIG, conditions=("displacement=2",))
    scores = [as_score(score_trajectory(Estimates.of(estimate), each, config)) for each in (truth, alone(truth))]
    counts = [score.number("chord", "n", condition="displacement=2") for score in scores]
    assert counts[0] == counts[1] > 10


def test_what_needs_attitudes_is_refused_or_unknown() -> None:
    truth, estimate = drive()
    part = alone(truth)
    limits = parse_limits(
        {
            "trajectory": [
                {"condition": "distance=2", "heading_mean_plus_3sigma_deg": 5.0, "chord_mean_plus_3sigma_m": 1.0}
            ]
        },
        "limits",
    )
    score = scored(estimate, part)
    assert [str(item.state) for item in judged_by(score, limits).verdicts] == ["not enough data", "pass"]
    assert from_json(to_json(score)) == score
    with pytest.raises(MetricsError, match="turn=DEG requires true attitudes"):
        score_trajectory(Estimates.of(estimate), part, replace(CONFIG, conditions=("turn=20",)))
    with pytest.raises(MetricsError, match="estimate has only positions"):
        scored(part, truth)
    assert diagnose(estimate, part, AssociationConfig()).found is None
    errors = Score(figures=aligned_errors(estimate, part, AlignedErrorConfig()).figures)
    ape, rpe = (errors.number(name, "rmse", part="translation") for name in ("ape", "rpe"))
    assert ape > rpe > 0.0
    assert [errors.number(name, "rmse", part="rotation") for name in ("ape", "rpe")] == [None, None]
    with pytest.raises(MetricsError, match="origin"):
        aligned_errors(estimate, part, AlignedErrorConfig(align="origin"))


def test_the_noise_of_the_truth_is_in_the_consistency() -> None:
    """A perfect estimate with a small covariance looks overconfident by a noisy truth, unless the noise is stated."""
    rng = np.random.default_rng(5)
    true, _ = drive()
    sigma_m, sigma_deg = 0.02, 0.5
    tilt = Rotation.from_rotvec(np.radians(rng.normal(0.0, sigma_deg, (COUNT, 3))))
    noisy = Truth(
        STAMPS,
        true.positions + rng.normal(0.0, sigma_m, (COUNT, 3)),
        (tilt * Rotation.from_quat(true.quats_xyzw)).as_quat(),
    )
    covariance = np.arange(1, COUNT + 1)[:, None] * (1e-10 * np.eye(6)[UPPER])
    estimates = Estimates.of(true, covariance=covariance)
    config = replace(CONFIG, conditions=("frames=5",), spacing=1)
    exact = as_score(score_trajectory(estimates, noisy, config))
    stated = as_score(score_trajectory(estimates, replace(noisy, sigma_m=sigma_m, sigma_deg=sigma_deg), config))
    assert exact.number("nees", "mean", part="pose") > 1000.0
    for name, degrees in (("pose", 6.0), ("position", 3.0), ("attitude", 3.0)):
        assert stated.number("nees", "mean", part=name) == pytest.approx(degrees, rel=0.25)
    assert exact.truth.is_exact
    assert (stated.truth.sigma_m, stated.truth.sigma_deg, stated.truth.attitude) == (sigma_m, sigma_deg, True)
    assert stated.truth.path_excess > 0.1


@pytest.mark.parametrize(
    ("statistic", "times"),
    [
        *(("mean", 1), ("sigma", 1), ("rmse", 1), ("mean_plus_3sigma", np.sqrt(10.0))),
        *(("p50", 1), ("p95", 2), ("p99", 3), ("max", 3)),
    ],
)
def test_the_error_of_the_truth_counts_as_often_as_its_standard_deviation_does(statistic: str, times: float) -> None:
    truth, estimate = drive()
    sigma_m = 0.001
    noisy = scored(estimate, Truth(truth.stamps_ns, truth.positions, truth.quats_xyzw, sigma_m=sigma_m))
    error = times * np.sqrt(2.0) * np.sqrt(3.0) * sigma_m  # three axes at both ends
    value = noisy.number("position", statistic, condition="distance=2")
    for beyond, state in ((0.95, "not enough data"), (1.05, "pass")):
        entry = {"condition": "distance=2", f"position_{statistic}_m": value + beyond * error}
        limits = parse_limits({"minimum_independent": 1, "trajectory": [entry]}, "limits")
        assert judged_by(noisy, limits).on_limits[0].state == state


def test_the_truth_error_of_a_position_has_the_attitude_by_which_the_estimate_is_turned() -> None:
    """0.1 deg of the true attitude at N moves the end of 2 m by 5 mm; re-based by displacements, it moves nothing."""
    truth, estimate = drive()
    turned = Truth(truth.stamps_ns, truth.positions, truth.quats_xyzw, sigma_deg=0.1)
    exact, noisy = scored(estimate, truth), scored(estimate, turned)
    value = noisy.number("position", "sigma", condition="distance=2")
    assert value == exact.number("position", "sigma", condition="distance=2")
    expected = np.sqrt(2.0) * np.radians(0.1) * 2.0  # two axes turn the end
    found = noisy.number("truth_error", condition="distance=2", part="attitude at the start")
    assert found == pytest.approx(expected, rel=0.05)
    for beyond, state in ((0.9, "not enough data"), (1.1, "pass")):
        entry = {"condition": "distance=2", "position_sigma_m": value + beyond * found}
        limits = parse_limits({"minimum_independent": 1, "trajectory": [entry]}, "limits")
        verdict = judged_by(noisy, limits).on_limits[0]
        assert (verdict.state, verdict.truth_error) == (state, pytest.approx(found))
        assert verdict.by_reading == {"pose": state, "displacement": "pass", "position": "pass"}
        assert judged_by(exact, limits).on_limits[0].state == "pass"


@pytest.mark.parametrize("has_tilt", [True, False])
def test_the_truth_error_has_the_interpolation_of_attitudes(has_tilt: bool) -> None:
    """An exact estimate of a heading that oscillates by 2 deg in 4 s does not fail by an exact truth at 1 Hz."""
    time_s = np.arange(COUNT) * 0.1
    positions = np.column_stack((0.2 * time_s, np.zeros((COUNT, 2))))
    wobble_deg = 2.0 * np.sin(2.0 * np.pi * time_s / 4.0 + 0.4)
    estimate = Trajectory(STAMPS, positions, Rotation.from_euler("z", wobble_deg[:, None], degrees=True).as_quat())
    sparse = estimate[::10]
    truth = Truth(sparse.stamps_ns, sparse.positions, sparse.quats_xyzw, has_tilt=has_tilt)
    config = replace(CONFIG, conditions=("distance=1",), spacing=3, association=AssociationConfig(truth="interpolate"))
    score = as_score(score_trajectory(Estimates.of(estimate), truth, config))
    figures = ("position", "heading", "attitude") if has_tilt else ("position", "heading")
    rows = [score.judged_row(name) for name in figures]
    limits = {f"{row.figure}_mean_plus_3sigma_{row.unit}": 0.7 * row.mean_plus_3sigma for row in rows}
    content = {"minimum_independent": 1, "trajectory": [{"condition": "distance=1", **limits}]}
    judged = judged_by(score, parse_limits(content, "limits")).on_limits
    assert [item.state for item in judged] == ["not enough data"] * len(figures)
    exact = as_score(score_trajectory(Estimates.of(estimate), estimate, config))
    assert exact.number("truth_error", part="attitude") == 0.0


def test_a_turn_of_a_truth_without_roll_and_pitch_is_refused() -> None:
    """The tilt of the estimate would otherwise decide where the sub-trajectories end."""
    truth, estimate = drive()
    planar = Truth(truth.stamps_ns, truth.positions, truth.quats_xyzw, has_tilt=False)
    config = TrajectoryScoreConfig(conditions=("turn=5",))
    with pytest.raises(MetricsError, match="turn=DEG"):
        score_trajectory(Estimates.of(estimate), planar, config)


def test_estimated_roll_and_pitch_of_a_planar_truth_are_no_turn_of_the_rover() -> None:
    """The rover stands for three quarters of the drive. The roll of the estimate oscillates by 3 deg meanwhile."""
    positions = np.zeros((COUNT, 3))
    positions[:, 0] = np.maximum(0.0, np.arange(COUNT) - 0.75 * COUNT) * 0.05
    level = np.tile([0.0, 0.0, 0.0, 1.0], (COUNT, 1))
    rolls = Rotation.from_euler("x", 3.0 * np.sin(0.37 * np.arange(COUNT))[:, None], degrees=True)
    truth = Truth(STAMPS, positions, level, has_tilt=False)
    score = scored(Trajectory(STAMPS, positions, rolls.as_quat()), truth)
    standing = score.number("standing", "value", condition="time=5", part="sub-trajectories")
    assert standing == pytest.approx(0.75, abs=0.15)


@pytest.mark.parametrize("has_attitude", [True, False])
def test_placeholders_of_unknown_heights_change_no_figure(has_attitude: bool) -> None:
    """The path, the ends of the sub-trajectories and the gaps are horizontal, and copies are compared in x and y."""
    true, estimate = drive()
    quats = true.quats_xyzw if has_attitude else np.zeros((COUNT, 4))
    config = replace(CONFIG, conditions=("distance=2", "displacement=2", "time=5"))
    found = []
    for sigma_m in (0.0, 0.02):
        positions = true.positions.copy()
        positions[:, 2] = np.random.default_rng(2).normal(0.0, sigma_m, COUNT)
        truth = Truth(STAMPS, positions, quats, has_height=False)
        of_estimates = [score_trajectory(Estimates.of(each), truth, config) for each in (estimate, true)]
        found.append(of_estimates)
        length_m = np.linalg.norm(np.diff(true.positions[:, :2], axis=0), axis=1).sum()
        assert of_estimates[0].association.path_length_m == pytest.approx(length_m)
        assert as_score(of_estimates[1]).number("poses_of_truth") == 1.0
        beyond = Condition.parse(f"distance={length_m + 0.1}")
        assert conditions_beyond(truth, [beyond])
    for level, noisy in zip(*found, strict=True):
        assert level.figures == noisy.figures
