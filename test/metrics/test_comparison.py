"""Which of two estimates is better: paired, with an interval that chance does not deceive."""

from functools import cache
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from helpers.random_drives import drive, score_of
from sfr_loc_map.errors import MetricsError
from sfr_loc_map.metrics.comparison import Comparison, compare_scores
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.figures.rows import figure_row
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.report.comparison import comparison_tables, summary_of


@cache
def scores(seed: int, noises: tuple[float, ...], count: int = 800, over: str = "distance=5") -> list[Score]:
    """Scores of estimates whose steps have errors of different size, the same shape for all."""
    truth, _ = drive(seed, count)
    wander = np.cumsum(np.random.default_rng(seed).normal(0, 1, (count, 3)), axis=0)
    config = TrajectoryScoreConfig(conditions=(over,))
    return [score_of((truth[0], truth[1] + noise * wander, truth[2]), truth, config) for noise in noises]


def outcome(result: Comparison) -> str:
    """The outcome of the position over 5 m."""
    return result.pairs[0].outcome


def test_twice_the_error_is_worse_and_half_is_better() -> None:
    both = scores(1, (0.005, 0.010))
    worse, better = compare_scores(both, ["good", "bad"]), compare_scores(both[::-1], ["bad", "good"])
    assert (outcome(worse), outcome(better)) == ("worse", "better")
    pair = worse.pairs[0]
    assert pair.difference == pytest.approx(pair.first, rel=1e-6)
    assert pair.ci95 is not None
    assert pair.ci95[0] < pair.difference < pair.ci95[1]
    assert {item.outcome for item in compare_scores([both[0]] * 2, ["a", "b"]).pairs} == {"equal"}


def test_a_summary_does_not_call_scores_equal_that_were_not_compared() -> None:
    both = scores(1, (0.005, 0.010))
    incomplete = [both[0], replace(both[1], incomplete="half of the drive is missing")]
    heading, text = summary_of(compare_scores(incomplete, ["all", "half"]))
    assert heading == "no paired comparison"
    assert "because half is incomplete" in text
    assert summary_of(compare_scores([both[0]] * 2, ["a", "b"]))[0] == "no difference shown"


def test_a_comparison_names_the_incomplete_score() -> None:
    part, complete = scores(1, (0.005, 0.010))
    result = compare_scores([replace(part, incomplete="half of the drive is missing"), complete], ["part", "all"])
    _, text = summary_of(result)
    assert "part is incomplete" in text
    assert "all is incomplete" not in text
    pairs, *_ = comparison_tables(result)
    assert {row[-1].text for row in pairs.rows} == {"incomplete: part"}


@pytest.mark.slow
def test_estimates_that_differ_by_chance_are_not_called_different() -> None:
    """Of 8 pairs of equally good estimates few may be told apart."""
    told, config = 0, TrajectoryScoreConfig(conditions=("distance=5",))
    for seed in range(8):
        truth, _ = drive(seed, 500)
        rng = np.random.default_rng(1000 + seed)
        both = [(truth[0], truth[1] + np.cumsum(rng.normal(0, 0.01, (500, 3)), axis=0), truth[2]) for _ in range(2)]
        made = [score_of(each, truth, config) for each in both]
        told += outcome(compare_scores(made, ["a", "b"])) != "no difference shown"
    assert told <= 2


def test_scores_with_samples_of_different_density_are_compared_by_the_common_sample() -> None:
    """A score of 10 700 frames keeps every second of 1065 sub-trajectories; one of 9 000 frames keeps all 896."""
    truth, _ = drive(4, 10_700)
    config = TrajectoryScoreConfig(conditions=("frames=50",))
    noise = np.cumsum(np.random.default_rng(4).normal(0, 0.01, (10_700, 3)), axis=0)
    long, short = (
        score_of(
            (truth[0][:end], truth[1][:end] + noise[:end], truth[2][:end]), tuple(each[:end] for each in truth), config
        )
        for end in (10_700, 9_000)
    )
    pair = compare_scores([long, short], ["long", "short"]).pairs[0]
    assert (pair.every, pair.count, pair.ci95) == (2, 448, (0.0, 0.0))
    assert pair.outcome == "equal", "each score is complete for its own truth, and the common sample is equal"
    assert pair.left_out == (533 - 448, 0)
    later = score_of((truth[0][10:], truth[1][10:] + noise[10:], truth[2][10:]), truth, config)
    pair = compare_scores([long, later], ["long", "later"]).pairs[0]
    assert (pair.every, pair.count, pair.outcome) == (2, 0, "not enough data"), "its sample has the other half"
    (note,) = (table.note for table in comparison_tables(compare_scores([long, later], ["long", "later"])))
    assert "one in 2" in note


def whole_run(coverage: float, mapping_p95: float | None = None) -> Score:
    return Score(figures=(figure_row("coverage", value=coverage), figure_row("mapping", p95=mapping_p95)))


def test_an_incomplete_run_is_named_beside_its_figures() -> None:
    lacking = replace(whole_run(0.6), incomplete="the map contains 1 of 2 pairs")
    result = compare_scores([whole_run(0.5), lacking], ["a", "b"])
    assert result.incomplete == (None, "the map contains 1 of 2 pairs")
    (table,) = comparison_tables(result)
    assert table.note == "b is incomplete: the map contains 1 of 2 pairs."


def test_whole_runs_are_side_by_side() -> None:
    result = compare_scores([whole_run(0.5, 0.1), whole_run(0.6), whole_run(0.7, 0.3)], ["a", "b", "c"])
    found = {item.label: item.values for item in result.side_by_side}
    assert found == {"coverage": (0.5, 0.6, 0.7), "mapping p95": (0.1, None, 0.3)}


def test_unlike_scores_are_refused() -> None:
    truth, estimate = drive(5, 300)
    a, other = score_of(estimate, truth), score_of(estimate, truth, TrajectoryScoreConfig(rebase="position"))
    cases: list[tuple[list[Any], str]] = [
        ([a, other], "re-based"),
        ([a], "two scores"),
        ([whole_run(0.5), Score()], "in common"),
        ([a, score_of(estimate, (truth[0] + 7, *truth[1:]), TrajectoryScoreConfig())], "in common"),
    ]
    for given, words in cases:
        with pytest.raises(MetricsError, match=words):
            compare_scores(given, ["a", "b"][: len(given)])


@pytest.mark.parametrize("names", [["a", "a", "b"], ["a", "b", "b"], ["a", "b"], ["a", "b", "c", "d"]])
def test_each_compared_score_requires_a_unique_name(names: list[str]) -> None:
    with pytest.raises(MetricsError, match="give each score a unique name"):
        compare_scores([whole_run(0.5), whole_run(0.6), whole_run(0.7)], names)


def test_few_sub_trajectories_are_not_enough_for_the_comparison_where_they_are_not_for_the_score() -> None:
    """Starts that overlap are fewer than two independent ones: no interval here or there, nobody is worse."""
    both = scores(3, (0.001, 0.010), 70, "distance=7.5")
    row = both[0].figure("position")
    assert row.independent < 2
    assert row.interval is None
    for pair in compare_scores(both, ["a", "b"]).pairs[:1]:
        assert (pair.count, pair.outcome, pair.ci95) == (row.n, "not enough data", None)


def test_worse_is_said_only_where_the_corrected_p_says_so() -> None:
    """An interval of one comparison of many that leaves zero out is not enough."""
    said = []
    for seed in range(3):
        truth, _ = drive(seed, 500)
        rng = np.random.default_rng(seed)
        steps = (rng.normal(0, noise, (500, 3)) for noise in (0.010, 0.012, 0.014, 0.016, 0.018))
        made = [score_of((truth[0], truth[1] + np.cumsum(step, axis=0), truth[2]), truth) for step in steps]
        said += [pair for pair in compare_scores(made, list("abcde")).pairs if pair.p_corrected is not None]
    assert {"worse", "no difference shown"} <= {pair.outcome for pair in said}
    assert all((pair.outcome in ("better", "worse")) == ((pair.p_corrected or 0.0) <= 0.05) for pair in said)
    assert any(pair.outcome == "no difference shown" and pair.ci95 and pair.ci95[0] > 0.0 for pair in said)


def test_nothing_is_said_of_attitudes_that_are_not_known() -> None:
    both = scores(3, (0.001, 0.010), 200, "distance=1")
    for score in both:
        assert score.details is not None
    without = [
        replace(
            score,
            details=replace(
                score.details,
                trajectory=replace(
                    score.details.trajectory,
                    sub_trajectories=tuple(
                        replace(rows, attitude_deg=(None,) * len(rows.attitude_deg))
                        for rows in score.details.trajectory.sub_trajectories
                    ),
                ),
            ),
        )
        for score in both
    ]
    for pair in compare_scores(without, ["a", "b"]).pairs:
        if pair.figure == "attitude":
            assert (pair.outcome, pair.first, pair.ci95) == ("not enough data", None, None)


def test_scores_of_other_truths_are_refused_without_hashes() -> None:
    """Without a provenance, the true positions of the plots are compared."""
    truth, estimate = drive(3, 400)
    swapped = truth[0], truth[1][:, [1, 0, 2]], truth[2]
    first = score_of(estimate, truth)
    assert compare_scores([first, score_of(estimate, truth)], ["a", "b"]).pairs
    with pytest.raises(MetricsError, match="compare scores of the same data"):
        compare_scores([first, score_of(estimate, swapped)], ["a", "b"])
