import math
from dataclasses import fields

import numpy as np
import pytest
import reference
from hypothesis import given
from hypothesis import strategies as st
from random_drives import Poses, drive, rows, spoilt, trajectory

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.metrics.association import Estimates
from sfr_loc_map.metrics.config import Condition, ConditionKind, TrajectoryScoreConfig
from sfr_loc_map.metrics.trajectory_score import score_trajectory

CONDITIONS = (("distance", 5.0), ("distance", 0.3), ("time", 3.0), ("frames", 17))


def compare(estimate: Poses, truth: Poses, kind: str, value: float, spacing: int, rebase: str) -> None:
    config = TrajectoryScoreConfig(conditions=(f"{kind}={value:g}",), spacing=spacing, rebase=rebase)
    got = score_trajectory(Estimates.of(trajectory(estimate)), trajectory(truth), config).score
    wanted = reference.score(estimate, truth, kind, value, spacing, rebase)
    assert got.first.count == wanted["count"]
    assert got.matched == wanted["matched"]
    for name in ("position_m", "attitude_deg", "heading_deg"):
        figure = getattr(got.first, name)
        for key, value_wanted in zip(("mean", "sigma", "mean_plus_3sigma"), wanted[name], strict=True):
            if math.isnan(value_wanted):
                assert getattr(figure, key) is None
            else:
                assert getattr(figure, key) == pytest.approx(value_wanted, abs=1e-9), (name, key)


@pytest.mark.clause("4.1.1", "4.1.2", "4.1.3", "4.2.3.1", "4.2.3.2", "4.2.3.3")
@pytest.mark.parametrize("rebase", ["pose", "position"])
@pytest.mark.parametrize("seed", range(12))
def test_agrees_with_the_plain_reference(seed: int, rebase: str) -> None:
    truth, estimate = drive(seed, 40 + 5 * seed, turns=seed % 2 == 0, stand=seed % 3 == 0)
    if seed % 4 == 1:
        estimate, truth = spoilt(estimate, seed), spoilt(truth, seed + 1, keep=0.8)
    if seed % 4 == 2:
        estimate = rows(estimate, slice(7, -9))
    if seed % 4 == 3:
        truth = rows(truth, slice(None, None, 2))
    kind, value = CONDITIONS[seed % len(CONDITIONS)]
    compare(estimate, truth, kind, value, 1 + seed % 11, rebase)


@pytest.mark.clause("4.1.1")
def test_a_distance_reached_exactly_ends_the_sub_trajectory() -> None:
    count = 200
    positions = np.column_stack((np.cumsum(np.full(count, 0.1)), np.zeros((count, 2))))
    poses = (np.arange(count) * 100_000_000, positions, np.tile([0.0, 0, 0, 1], (count, 1)))
    config = TrajectoryScoreConfig(spacing=1)
    details = score_trajectory(Estimates.of(trajectory(poses)), trajectory(poses), config).details
    assert details is not None
    found = details.sub_trajectories[0]
    assert set(np.subtract(found.end_frame, found.start_frame).tolist()) == {50}
    assert len(found.start_frame) == count - 50


@pytest.mark.clause("4.1.3", "4.2.3.1", "4.2.3.2")
def test_golden_statistics_by_hand() -> None:
    """Straight drive of 1 m steps; estimates stray by known vectors: mean (0.1, 0, 0) +- 0.1 along x."""
    truth = (
        np.arange(4) * 1_000_000_000,
        np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]]),
        np.tile([0.0, 0, 0, 1], (4, 1)),
    )
    estimate = (truth[0], np.array([[0.0, 0, 0], [1.0, 0, 0], [2.1, 0, 0], [3.3, 0, 0]]), truth[2])
    config = TrajectoryScoreConfig(conditions=("distance=1",), spacing=1)
    got = score_trajectory(Estimates.of(trajectory(estimate)), trajectory(truth), config).score
    assert got.first.count == 3
    assert got.first.position_m.mean == pytest.approx(0.1)
    assert got.first.position_m.sigma == pytest.approx(0.1)
    assert got.first.position_m.mean_plus_3sigma == pytest.approx(0.4)
    attitude = got.first.attitude_deg
    assert (attitude.mean, attitude.sigma, attitude.mean_plus_3sigma) == (0.0, 0.0, 0.0)


@pytest.mark.clause("4.2.3.3")
def test_heading_mean_is_signed_and_its_sum_is_not() -> None:
    truth, _ = drive(3, 30)
    turned = truth[2].copy()
    for k in range(len(turned)):
        half = np.radians(-0.5 * k)
        x, y, z, w = truth[2][k]
        s, c = math.sin(half / 2), math.cos(half / 2)
        turned[k] = (c * x - s * y, c * y + s * x, c * z + s * w, c * w - s * z)
    config = TrajectoryScoreConfig(conditions=("frames=2",), spacing=1)
    got = score_trajectory(Estimates.of(trajectory((truth[0], truth[1], turned))), trajectory(truth), config)
    heading = got.score.first.heading_deg
    assert heading.mean == pytest.approx(-1.0, abs=1e-9)
    assert heading.mean_plus_3sigma == pytest.approx(1.0, abs=1e-6)


@pytest.mark.clause("4.1.3")
def test_one_sub_trajectory_has_a_mean_but_no_sigma() -> None:
    truth, estimate = drive(1, 30)
    config = TrajectoryScoreConfig(conditions=("frames=20", "frames=1000"))
    got = score_trajectory(Estimates.of(trajectory(estimate)), trajectory(truth), config).score
    position = got.first.position_m
    assert (got.first.count, position.sigma, position.mean_plus_3sigma) == (1, None, None)
    assert position.mean is not None
    assert (got.conditions[1].count, got.conditions[1].attitude_deg.mean) == (0, None)


def test_lost_stretch_counts_and_is_told() -> None:
    truth, estimate = drive(2, 60)
    lost = np.zeros(60, bool)
    lost[20:35] = True
    estimate[1][20:35] = estimate[1][19]
    estimate[2][20:35] = estimate[2][19]
    config = TrajectoryScoreConfig(conditions=("frames=10",), spacing=1)
    got = score_trajectory(Estimates.of(trajectory(estimate), lost), trajectory(truth), config).score
    assert (got.lost, got.matched, got.first.count) == (15, 60, 50)
    compare(estimate, truth, "frames", 10, 1, "pose")


def test_nothing_in_common_is_an_error() -> None:
    truth, estimate = drive(5, 20)
    later = (estimate[0] + 10**15, estimate[1], estimate[2])
    with pytest.raises(MetricsError, match="no estimate has a truth"):
        score_trajectory(Estimates.of(trajectory(later)), trajectory(truth), TrajectoryScoreConfig())


@given(st.sampled_from(ConditionKind), st.integers(1, 10**6))
def test_every_spelling_of_a_condition_reads_back(kind: ConditionKind, value: int) -> None:
    condition = Condition(kind, float(value))
    assert Condition.parse(condition.setting) == condition
    assert Condition.from_plain(condition.to_plain()) == condition
    assert condition.label == f"{value:g} {kind.unit}" == str(condition)


def test_what_is_no_condition_is_refused() -> None:
    for text in ("distance=0", "distance=-1", "distance", "time=nan", "time=1e300", "frames=1.5", "speed=3", ""):
        with pytest.raises(MetricsError, match="is not a condition"):
            Condition.parse(text)
    pairs: list[object] = [None, {}, {"distance_m": True}, {"distance_m": 1, "time_s": 2}, {"frames": 1.5}, 5]
    for value in pairs:
        with pytest.raises(ValueError, match=r"condition|ends no"):
            Condition.from_plain(value)


def test_error_by_direction_of_travel() -> None:
    """Driving north; the estimate is 1 % short, drifts 2 % to the right (east) and 3 % up."""
    count = 101
    north = 0.1 * np.arange(count)
    quat = np.tile([0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)], (count, 1))
    stamps = np.arange(count) * 100_000_000
    truth = (stamps, np.column_stack((0 * north, north, 0 * north)), quat)
    estimate = (stamps, np.column_stack((0.02 * north, 0.99 * north, 0.03 * north)), quat)
    got = score_trajectory(Estimates.of(trajectory(estimate)), trajectory(truth), TrajectoryScoreConfig())
    components = got.score.first.components
    means = {item.name: getattr(components, item.name).mean for item in fields(components)}
    wanted = {"x_m": 0.1, "y_m": -0.05, "z_m": 0.15, "along_m": -0.05, "cross_m": -0.1, "vertical_m": 0.15}
    assert means == pytest.approx(wanted, abs=1e-12)
    by_distance = {item.distance_m: item.position_m.mean for item in got.score.by_distance}
    length = math.sqrt(0.01**2 + 0.02**2 + 0.03**2)
    assert by_distance == pytest.approx({d: d * length for d in (1.0, 2.0, 5.0, 10.0)}, abs=1e-12)


def test_interval_lies_around_the_figure_and_needs_enough() -> None:
    truth, estimate = drive(21, 900)
    long = score_trajectory(Estimates.of(trajectory(estimate)), trajectory(truth), TrajectoryScoreConfig())
    for name in ("position_m", "attitude_deg", "heading_deg"):
        figure = getattr(long.score.first, name)
        assert figure.mean_plus_3sigma_ci95 is not None
        low, high = figure.mean_plus_3sigma_ci95
        assert 0 < low < figure.mean_plus_3sigma < high
    short = rows(truth, slice(0, 24)), rows(estimate, slice(0, 24))
    few = score_trajectory(Estimates.of(trajectory(short[1])), trajectory(short[0]), TrajectoryScoreConfig())
    assert few.score.first.position_m.mean_plus_3sigma_ci95 is None
