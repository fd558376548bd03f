"""Comparison of two suites: paired by drive, with a test over all drives."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from msgspec.structs import replace as struct_replace

from helpers.made_suites import JOB, recording
from sfr_loc_map.errors import MetricsError
from sfr_loc_map.metrics.comparison import Outcome
from sfr_loc_map.metrics.figures.rows import figure_row
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.statistics.intervals import holm
from sfr_loc_map.suite.pages.tables import comparison_tables
from sfr_loc_map.suite.statistics.common_deviations import CommonDeviation
from sfr_loc_map.suite.statistics.comparison import compare_suites, ratio_interval, sign_flip_p
from sfr_loc_map.suite.statistics.figures import LEAST_ERROR, figures_of
from sfr_loc_map.suite.statistics.scored_job import ScoredJob
from sfr_loc_map.suite.statistics.summary import Summary

POSITION = "position over 1 m, m"


def scaled(score: Score, factor: float) -> Score:
    position, *others = score.figures
    assert position.figure == "position"
    larger = struct_replace(position, mean_plus_3sigma=factor * position.mean_plus_3sigma)
    return struct_replace(score, figures=(larger, *others))


def summary(score: Score, factors: dict[str, float]) -> Summary:
    drives = tuple(
        ScoredJob(replace(JOB, source=recording(name, sha256=name)), scaled(score, factor))
        for name, factor in factors.items()
    )
    return Summary(groups=(), results=drives, failures=(), refusals=(), code="")


def names(count: int) -> list[str]:
    return [f"drive {number}" for number in range(count)]


def test_errors_larger_on_every_drive_are_worse(score: Score) -> None:
    rng = np.random.default_rng(0)
    factors = {name: float(rng.uniform(1.02, 1.3)) for name in names(10)}
    before = summary(score, dict.fromkeys(names(10), 1.0))
    result = compare_suites(before, summary(score, factors), ("a", "b"))
    by_name = {item.figure: item for item in result.figures}
    found = by_name[POSITION]
    assert found.outcome is Outcome.WORSE
    assert found.ratio == pytest.approx(np.exp(np.mean(np.log(list(factors.values())))))
    assert found.ci95 is not None
    assert found.ci95[0] < found.ratio < found.ci95[1]
    assert (found.p, found.p_corrected) == (2 / 2**10, pytest.approx(2 / 2**10 * len(by_name)))
    assert found.worst.label == f"localise {max(factors, key=lambda name: factors[name])}, default"
    assert by_name["heading over 1 m, deg"].outcome is Outcome.EQUAL


def test_one_bad_drive_decides_nothing(score: Score) -> None:
    factors = dict.fromkeys(names(10), 1.0) | {"drive 3": 30.0}
    result = compare_suites(summary(score, dict.fromkeys(names(10), 1.0)), summary(score, factors), ("a", "b"))
    found = next(item for item in result.figures if item.figure == POSITION)
    assert found.outcome is Outcome.NO_DIFFERENCE
    assert found.worst.label == "localise drive 3, default"
    assert found.worst.log == pytest.approx(np.log(30.0))


def test_drives_of_one_suite_only_are_counted(score: Score) -> None:
    both = compare_suites(
        summary(score, dict.fromkeys(["x", "y", "z"], 1.0)), summary(score, dict.fromkeys(["y"], 2.0)), ("a", "b")
    )
    assert (both.common, both.left_out) == (1, (2, 0))
    assert next(item for item in both.figures if item.figure == POSITION).outcome is Outcome.NOT_ENOUGH_DATA
    with pytest.raises(MetricsError, match="no drive in common"):
        compare_suites(summary(score, {"x": 1.0}), summary(score, {"y": 1.0}), ("a", "b"))


def test_a_method_that_loses_half_of_the_drives_is_not_better(score: Score) -> None:
    before = summary(score, dict.fromkeys(names(20), 1.0))
    after = summary(score, dict.fromkeys(names(20), 0.9))
    without_errors = struct_replace(score, figures=tuple(row for row in score.figures if row.figure != "position"))
    lost = tuple(replace(item, score=without_errors) for item in after.results[:10])
    losing = replace(after, results=lost + after.results[10:])
    found = next(item for item in compare_suites(before, losing, ("a", "b")).figures if item.figure == POSITION)
    assert (found.drives, found.without) == (20, (0, 10))
    assert found.ratio == pytest.approx(0.9)
    assert found.outcome is Outcome.NO_DIFFERENCE
    assert found.worst.other is None
    found = next(item for item in compare_suites(losing, before, ("b", "a")).figures if item.figure == POSITION)
    assert (found.without, found.outcome) == ((10, 0), Outcome.NO_DIFFERENCE)


def test_a_method_that_loses_every_drive_is_worse(score: Score) -> None:
    before = summary(score, dict.fromkeys(names(10), 1.0))
    without_errors = struct_replace(score, figures=tuple(row for row in score.figures if row.figure != "position"))
    losing = replace(before, results=tuple(replace(item, score=without_errors) for item in before.results))
    found = next(item for item in compare_suites(before, losing, ("a", "b")).figures if item.figure == POSITION)
    assert (found.drives, found.without, found.ratio) == (10, (0, 10), None)
    assert found.outcome is Outcome.WORSE


def test_lost_and_degraded_frames_are_added_over_the_common_results(score: Score) -> None:
    def with_counts(lost: int | None, degraded: int) -> Score:
        assert score.association is not None
        return struct_replace(score, association=struct_replace(score.association, lost=lost, degraded=degraded))

    before = summary(with_counts(1, 0), dict.fromkeys(names(3), 1.0))
    after = summary(with_counts(4, 2), dict.fromkeys(names(3), 1.0))
    unknown = replace(after.results[0], score=with_counts(None, 2))
    after = replace(after, results=(unknown, *after.results[1:]))
    result = compare_suites(before, after, ("a", "b"))
    found = {item.figure: (item.results, item.first, item.other) for item in result.counts}
    assert (found["lost, frames"], found["degraded, frames"]) == ((2, 2, 8), (3, 0, 6))
    assert {"comparison", "counts"} <= {table.name for table in comparison_tables(result)}
    assert [item.outcome for item in result.figures if item.figure == POSITION] == [Outcome.EQUAL]


def test_the_deviations_and_missing_results_of_both_suites_are_listed(score: Score) -> None:
    first, other = (summary(score, dict.fromkeys(names(3), 1.0)) for _ in range(2))
    deviation = CommonDeviation(text="The truth has gaps.", results=3, of="all results")
    other = replace(other, waiting_jobs=("a", "b"), deviations=(deviation,))
    result = compare_suites(first, other, ("a", "b"))
    assert [suite.without_result for suite in result.suites] == [0, 2]
    assert [suite.deviations for suite in result.suites] == [(), (deviation,)]
    (table,) = [table for table in comparison_tables(result) if table.name == "deviations"]
    assert [cell.text for cell in table.rows[0]][:2] == ["The truth has gaps.", "b"]


@pytest.mark.parametrize("drives", [5, 6, 12])
def test_the_interval_of_the_ratio_covers_95_percent(drives: int) -> None:
    """The percentiles of the resamplings cover only 85 % for 5 drives."""
    rng = np.random.default_rng(drives)
    intervals = [ratio_interval(rng.normal(0.1, 0.3, drives)) for _ in range(1000)]
    assert np.mean([low <= np.exp(0.1) <= high for low, high in intervals]) > 0.93


def test_exact_probability_is_that_of_all_signs() -> None:
    logs = np.array([0.3, -0.1, 0.2, 0.5, 0.05, 0.4, -0.02])
    sums = [abs(sum(s * v for s, v in zip(signs, logs, strict=True))) for signs in itertools.product((1, -1), repeat=7)]
    expected = np.mean([value >= abs(logs.sum()) - 1e-12 for value in sums])
    assert sign_flip_p(logs) == pytest.approx(expected)
    found = [sign_flip_p(values) for values in (np.full(8, 0.1), np.full(5, 0.1), np.zeros(9))]
    assert found == [2 / 2**8, None, 1.0], "the smallest there is, too few drives, no difference at all"


def test_holm_is_as_in_the_text() -> None:
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.5, None, 0.9]) == pytest.approx([1.0, None, 1.0])


def test_an_error_of_zero_is_a_figure_and_a_time_of_zero_is_unknown(score: Score) -> None:
    figures = (*scaled(score, 0.0).figures, figure_row("localisation", mean=0.0))
    found = {name.name: value for name, value in figures_of(struct_replace(score, figures=figures)).items()}
    assert found[POSITION] == LEAST_ERROR
    assert "localisation mean, s" not in found
