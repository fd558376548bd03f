"""Suites compared: paired by drive, decided over all of them. Drives of histories are drawn from simulated errors."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from made_suites import JOB

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.metrics.comparison import Outcome
from sfr_loc_map.metrics.score import Score
from sfr_loc_map.metrics.statistics import holm
from sfr_loc_map.suite.comparison import FigureKind, FigureName, HistoryRun, compare_suites, find_changes, sign_flip_p
from sfr_loc_map.suite.summary import ScoredJob, Summary

POSITION = "position over 1 m, m"
FIGURE = FigureName(FigureKind.ACCURACY, "position over 5 m, m")
DRIVES, ROWS = 20, 30


def scaled(score: Score, factor: float) -> Score:
    trajectory = score.trajectory
    assert trajectory is not None
    position = trajectory.first.position_m
    assert position.mean_plus_3sigma is not None
    larger = replace(position, mean_plus_3sigma=factor * position.mean_plus_3sigma)
    return replace(score, trajectory=replace(trajectory, first=replace(trajectory.first, position_m=larger)))


def summary(score: Score, factors: dict[str, float]) -> Summary:
    drives = tuple(
        ScoredJob(replace(JOB, source=replace(JOB.source, name=name, sha256=name)), scaled(score, factor))
        for name, factor in factors.items()
    )
    return Summary(tasks=len(drives), waiting=0, groups=(), drives=drives, failures=(), refusals=(), code="")


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
    assert (found.worst.label, found.worst.other / found.worst.first) == (
        "localise drive 3, default",
        pytest.approx(30.0),
    )


def test_drives_of_one_suite_only_are_counted(score: Score) -> None:
    both = compare_suites(
        summary(score, dict.fromkeys(["x", "y", "z"], 1.0)), summary(score, dict.fromkeys(["y"], 2.0)), ("a", "b")
    )
    assert (both.common, both.left_out) == (1, (2, 0))
    assert next(item for item in both.figures if item.figure == POSITION).outcome is Outcome.NOT_ENOUGH_DATA
    with pytest.raises(MetricsError, match="no drive in common"):
        compare_suites(summary(score, {"x": 1.0}), summary(score, {"y": 1.0}), ("a", "b"))


def errors(rng: np.random.Generator) -> np.ndarray:
    """Return errors `(drive, sub-trajectory, axis)`: drives differ, neighbours share most of their error."""
    size = np.exp(rng.normal(np.log(0.003), 0.4, (DRIVES, 1, 1)))
    steps = rng.normal(size=(DRIVES, ROWS + 4, 3))
    return size * np.stack([steps[:, k : k + ROWS] for k in range(5)]).sum(axis=0) / np.sqrt(5.0)


def run_of(name: str, rows: np.ndarray) -> HistoryRun:
    figure = np.linalg.norm(rows.mean(axis=1), axis=1) + 3.0 * np.linalg.norm(rows.std(axis=1, ddof=1), axis=1)
    return HistoryRun(name, {str(n): {FIGURE: float(value)} for n, value in enumerate(figure)})


def changed(rng: np.random.Generator, rows: np.ndarray, factor: float) -> np.ndarray:
    """Return the errors of other code: each differs by a tenth of the typical error of its drive, by chance."""
    scatter = 0.1 * rows.std(axis=(1, 2), keepdims=True)
    return factor * (rows + rng.normal(size=rows.shape) * scatter)


@pytest.mark.parametrize(("factor", "seed", "least", "most"), [(1.0, 1, 0, 1), (1.1, 2, 95, 100)])
def test_ten_per_cent_more_error_is_found_and_seldom_an_error_that_is_none(
    factor: float, seed: int, least: int, most: int
) -> None:
    found = 0
    for trial in range(100):
        rng = np.random.default_rng([seed, trial])
        rows = errors(rng)
        runs = [run_of("before", rows), run_of("after", changed(rng, rows, factor))]
        found += find_changes(runs).first_worse == {"accuracy": "after"}
    assert least <= found <= most


def test_the_first_worse_run_is_named_and_a_better_one_is_the_new_baseline() -> None:
    rng = np.random.default_rng(3)
    rows = errors(rng)
    factors = {"a": 1.0, "b": 1.0, "c": 0.8, "d": 0.92, "e": 1.3}
    history = find_changes([run_of(name, factor * rows) for name, factor in factors.items()])
    by_run = {point.runs: point for point in history.points}
    assert [by_run[name].outcome for name in "bcde"] == [*(Outcome.EQUAL, Outcome.BETTER, Outcome.WORSE, Outcome.WORSE)]
    assert (by_run["c"].baseline, by_run["d"].baseline) == ("a", "c")
    assert by_run["d"].ratio == pytest.approx(0.92 / 0.8)
    assert history.first_worse == {"accuracy": "d"}
    with pytest.raises(MetricsError, match="two suites"):
        find_changes([run_of("a", rows)])


@pytest.mark.parametrize(("drives", "runs", "found"), [(7, 2, False), (8, 2, True), (20, 201, True)])
def test_what_so_few_drives_cannot_show_is_not_called_no_difference(drives: int, runs: int, found: bool) -> None:
    rows = errors(np.random.default_rng(5))[:drives]
    names = [str(number) for number in range(runs)]
    factors = dict.fromkeys(names, 1.0) | {names[-1]: 1.3}
    history = find_changes([run_of(name, factor * rows) for name, factor in factors.items()])
    assert history.points[-1].outcome is (Outcome.WORSE if found else Outcome.NOT_ENOUGH_DATA)


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
