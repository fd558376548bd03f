from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from random_drives import drive, rows, trajectory

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.metrics.association import Estimates
from sfr_loc_map.metrics.calls import HOST_CLOCK, call_score
from sfr_loc_map.metrics.comparison import Comparison, compare_scores
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.limits import build_score
from sfr_loc_map.metrics.score import MapScore, Score, TimingScore
from sfr_loc_map.metrics.trajectory_score import score_trajectory

CONFIG = TrajectoryScoreConfig(conditions=("distance=5", "time=3"))


def score(estimate: Any, truth: Any, config: TrajectoryScoreConfig = CONFIG) -> Score:
    scored = score_trajectory(Estimates.of(trajectory(estimate)), trajectory(truth), config)
    return build_score(Score(verdicts=()), trajectory=scored)


def estimates(seed: int, noises: tuple[float, ...], count: int = 800) -> tuple[Any, list[Any]]:
    """One truth and estimates whose steps have errors of different size, the same shape for all."""
    truth, _ = drive(seed, count)
    rng = np.random.default_rng(seed)
    wander = np.cumsum(rng.normal(0, 1, (count, 3)), axis=0)
    return truth, [(truth[0], truth[1] + noise * wander, truth[2]) for noise in noises]


def outcomes(result: Comparison) -> dict[tuple[str, str], str]:
    return {(pair.figure, pair.condition.kind.key): pair.outcome for pair in result.pairs}


def test_twice_the_error_is_worse_and_half_is_better() -> None:
    truth, (good, bad) = estimates(1, (0.005, 0.010))
    scores = score(good, truth), score(bad, truth)
    worse = compare_scores(scores, ["good", "bad"])
    better = compare_scores(scores[::-1], ["bad", "good"])
    assert outcomes(worse)["position_m", "distance_m"] == "worse"
    assert outcomes(better)["position_m", "distance_m"] == "better"
    pair = worse.pairs[0]
    assert pair.difference == pytest.approx(pair.first, rel=1e-6)
    assert pair.ci95 is not None
    assert pair.ci95[0] < pair.difference < pair.ci95[1]


def test_pairing_shows_a_difference_that_two_intervals_do_not() -> None:
    truth, (a, b) = estimates(2, (0.0100, 0.0105))
    scores = score(a, truth), score(b, truth)
    intervals = [s.trajectory.first.position_m.mean_plus_3sigma_ci95 for s in scores if s.trajectory is not None]
    assert None not in intervals
    assert intervals[0][1] > intervals[1][0]
    assert outcomes(compare_scores(scores, ["a", "b"]))["position_m", "distance_m"] == "worse"


@pytest.mark.slow
def test_estimates_that_differ_by_chance_are_not_called_different() -> None:
    """Over 40 pairs of equally good estimates few may be told apart."""
    told = 0
    for seed in range(40):
        truth, _ = drive(seed, 500)
        rng = np.random.default_rng(1000 + seed)
        both = [(truth[0], truth[1] + np.cumsum(rng.normal(0, 0.01, (500, 3)), axis=0), truth[2]) for _ in range(2)]
        scores = [score(estimate, truth) for estimate in both]
        told += outcomes(compare_scores(scores, ["a", "b"]))["position_m", "distance_m"] != "no difference shown"
    assert told <= 6


def test_equal_scores_are_equal() -> None:
    truth, (a, _) = estimates(3, (0.01, 0.02))
    result = compare_scores([score(a, truth)] * 2, ["a", "b"])
    assert set(outcomes(result).values()) == {"equal"}


def test_only_common_sub_trajectories_are_compared() -> None:
    truth, (a, b) = estimates(4, (0.01, 0.02))
    result = compare_scores([score(a, truth), score(rows(b, slice(0, 500)), truth)], ["a", "b"])
    pair = result.pairs[0]
    assert 0 < pair.count < 50
    assert pair.left_out[0] > 0
    assert pair.left_out[1] == 0


def test_unlike_scores_are_refused() -> None:
    truth, (a, b) = estimates(5, (0.01, 0.02))
    other = TrajectoryScoreConfig(rebase="position")
    with pytest.raises(MetricsError, match="re-based"):
        compare_scores([score(a, truth), score(b, truth, other)], ["a", "b"])
    with pytest.raises(MetricsError, match="two scores"):
        compare_scores([score(a, truth)], ["a"])
    with pytest.raises(MetricsError, match="in common"):
        compare_scores([whole_run(0.5), Score(verdicts=())], ["a", "b"])


def whole_run(coverage: float, mapping_p95: float | None = None) -> Score:
    times = call_score(np.array([coverage]), HOST_CLOCK)
    part = MapScore(pairs=1, points=2, coverage=coverage, coverage_range_m=(0.0, 10.0), nearest_only=True)
    return Score(map=part, timing=TimingScore(mapping=replace(times, p95=mapping_p95)), verdicts=())


def test_a_map_alone_stands_beside_a_whole_run() -> None:
    truth, (a,) = estimates(5, (0.01,))
    result = compare_scores([replace(score(a, truth), map=whole_run(0.5).map), whole_run(0.6)], ["run", "map"])
    assert not result.pairs
    assert [(row.figure, row.values) for row in result.side_by_side] == [("map.coverage", (0.5, 0.6))]


def test_whole_runs_stand_side_by_side() -> None:
    result = compare_scores([whole_run(0.5), whole_run(0.6, 3.0)], ["a", "b"])
    rows_found = {row.figure: row.values for row in result.side_by_side}
    assert rows_found == {"map.coverage": (0.5, 0.6), "timing.mapping_s.p50": (0.5, 0.6)}


def test_the_json_of_a_comparison() -> None:
    truth, (a, b) = estimates(6, (0.01, 0.02), 300)
    plain = compare_scores([score(a, truth), score(b, truth)], ["a", "b"]).to_dict()
    assert list(plain) == ["schema", "names", "methods", "pairs", "side_by_side"]
    pairs = plain["pairs"]
    assert isinstance(pairs, list)
    keys = "name condition figure count left_out first other difference ci95 verdict p p_corrected"
    assert list(pairs[0]) == keys.split()
    assert pairs[0]["condition"] == {"distance_m": 5.0}
