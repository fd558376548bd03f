"""Pooled errors are those of all values together; the interval holds the truth as often as it says."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from helpers.made_suites import JOB
from helpers.random_drives import drive, score_of
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.judging.limits_file import parse_limits
from sfr_loc_map.metrics.judging.proof import sample_of
from sfr_loc_map.metrics.records import Provenance
from sfr_loc_map.metrics.score import Score
from sfr_loc_map.metrics.score_json import to_json
from sfr_loc_map.metrics.table import Figure, figure_row
from sfr_loc_map.suite.running.job import Job, JobOutcome
from sfr_loc_map.suite.running.store import Store
from sfr_loc_map.suite.statistics.group_verdicts import GroupVerdict, verdicts_over
from sfr_loc_map.suite.statistics.pooling import pool, pooled_row
from sfr_loc_map.suite.statistics.summary import SequentialDecision


def rows_of(values: np.ndarray) -> list[Figure]:
    """A row an axis."""
    return [
        figure_row("position", "distance=5", axis, n=len(column), mean=float(column.mean()), sigma=column.std(ddof=1))
        for axis, column in zip("xyz", values.T, strict=False)
    ]


def pooled(drives: list[np.ndarray], names: list[str]) -> Figure:
    return pooled_row(
        "position", "distance=5", [(name, rows_of(values)) for name, values in zip(names, drives, strict=True)]
    )


@settings(max_examples=50)
@given(
    sizes=st.lists(st.integers(2, 9), min_size=1, max_size=6),
    axes=st.sampled_from([1, 3]),
    seed=st.integers(0, 2**32 - 1),
    offset=st.sampled_from([0.0, 5.0, -300.0]),
)
def test_pooled_is_the_statistic_of_all_values(sizes: list[int], axes: int, seed: int, offset: float) -> None:
    rng = np.random.default_rng(seed)
    drives = [rng.normal(rng.normal() + offset, rng.uniform(0.1, 3.0), (size, axes)) for size in sizes]
    found = pooled(drives, [*map(str, range(len(drives)))])
    every = np.concatenate(drives)
    mean, sigma = np.linalg.norm(every.mean(axis=0)), np.linalg.norm(every.std(axis=0, ddof=1))
    assert found.mean == pytest.approx(every.mean() if axes == 1 else mean, rel=1e-9, abs=1e-9)
    assert abs(found.mean) == pytest.approx(mean, rel=1e-9, abs=1e-9)
    assert found.sigma == pytest.approx(sigma, rel=1e-9)
    assert found.mean_plus_3sigma == pytest.approx(mean + 3 * sigma, rel=1e-9)
    assert (found.n, found.independent) == (len(every), len(drives))
    assert (found.interval is None) == (len(sizes) < 5)
    repeated = pooled(drives, ["one"] * len(drives))
    assert (repeated.mean, repeated.interval) == (found.mean, None)  # repeats of one drive
    one = Score(figures=tuple(figure_row("position", "distance=5", axis, n=1, mean=1.0) for axis in "xyz"))
    assert [row.mean for row in pool([("a", one)], "distance=5")] == [None], "one value has no sigma"


def test_the_interval_holds_the_true_figure_nine_times_in_ten_at_least() -> None:
    rng = np.random.default_rng(5)
    held = 0
    for _ in range(200):
        drives = [rng.normal(0.0, 1.0, (30, 3)) * np.exp(rng.normal(0.0, 0.3)) for _ in range(15)]
        low, high = pooled(drives, [*map(str, range(15))]).interval
        held += low <= 3.0 * np.sqrt(3.0 * np.exp(2 * 0.3**2)) <= high
    assert held >= 180


def test_a_limit_with_a_share_over_drives_by_each_interpretation() -> None:
    """60 short drives prove 95 % with 95 %, one value a drive. No single drive does; one bad drive is too many."""
    results = []
    for number in range(60):
        truth, estimate = drive(number, count=60)
        results.append((str(number), score_of(estimate, truth, TrajectoryScoreConfig(conditions=("distance=5",)))))
    terms = {"prob": 0.95, "confidence": 0.95}

    def verdict(interpretation: str, chosen: list[tuple[str, Score]], limit: float = 10.0) -> GroupVerdict:
        entry = {**terms, "limit": limit, "interpretation": interpretation}
        content = {"trajectory": [{"condition": "distance=5", "position_bound_m": entry}]}
        (found,) = verdicts_over(parse_limits(content, "limits"), chosen, ())
        return found

    passed = verdict("ensemble", results)
    assert (passed.state, passed.n, passed.missed_by, passed.over) == ("pass", 60, 0, "all drives")
    largest = sorted(float(sample_of(score, "position", "distance=5").sizes.max()) for _, score in results)
    assert passed.value == pytest.approx(largest[-1])
    mixed = verdict("mixed", results)
    assert (mixed.state, mixed.n) == ("pass", 60)
    assert mixed.value <= passed.value
    one_bad = verdict("ensemble", results, limit=0.5 * (largest[-1] + largest[-2]))
    assert (one_bad.state, one_bad.missed_by) == ("not enough data", 1)
    assert one_bad.proof.more > 30
    assert verdict("ensemble", results, limit=0.0).state == "fail"
    few = verdict("ensemble", results[:40])
    assert (few.state, few.proof.more) == ("not enough data", 19)
    repeats = verdict("ensemble", [*results[:40], *[("0", score) for _, score in results[40:]]])
    assert (repeats.state, repeats.n) == ("not enough data", 40), "repeats are one drive"
    assert verdict("temporal", results).state == "not enough data"


def group_of(limit: str, bound: object, results: list[tuple[str, Score]]) -> GroupVerdict:
    """The verdict on one limit over drives."""
    content = {"trajectory": [{"condition": "distance=5", limit: bound}]}
    rows = tuple(row for row in pool(results, "distance=5"))
    (found,) = verdicts_over(parse_limits(content, "limits"), results, rows)
    return found


@pytest.mark.parametrize("statistic", ["rmse", "p50", "p95", "p99", "max"])
def test_a_limit_on_a_statistic_that_drives_do_not_pool_is_that_of_the_worst_drive(statistic: str) -> None:
    results = []
    for number in range(6):
        truth, estimate = drive(number, count=200)
        results.append((str(number), score_of(estimate, truth, TrajectoryScoreConfig(conditions=("distance=5",)))))
    values = [score.number("position", statistic, condition="distance=5") for _, score in results]
    for factor, state in ((1.01, "pass"), (0.99, "fail")):
        found = group_of(f"position_{statistic}_m", factor * max(values), results)
        assert (found.state, found.over, found.value, found.row) == (state, "worst drive", max(values), None)
        missed = sum(value > factor * max(values) for value in values)
        assert (found.missed_by, found.n) == (missed, sum(score.figure("position").n for _, score in results))
    truth, estimate = drive(0, count=80)
    short = score_of(estimate, truth, TrajectoryScoreConfig(conditions=("distance=5",)))
    few = group_of(f"position_{statistic}_m", 10.0, [("short", short)])
    assert (few.state, few.over) == ("not enough data", "worst drive"), short.figure("position").independent


def test_the_mean_of_a_signed_figure_over_drives_keeps_its_sign() -> None:
    left, right = (figure_row("heading", "distance=5", "pose", n=10, mean=mean, sigma=0.1) for mean in (-0.4, 0.2))
    row = pooled_row("heading", "distance=5", [("a", [left]), ("b", [right])])
    assert row.mean == pytest.approx(-0.1)
    assert row.mean_plus_3sigma == pytest.approx(0.1 + 3.0 * row.sigma)


def test_a_bound_over_drives_within_the_error_of_the_truth_decides_nothing() -> None:
    results = []
    for number in range(60):
        truth, estimate = drive(number, count=60)
        score = score_of(estimate, truth, TrajectoryScoreConfig(conditions=("distance=5",)))
        exact = tuple(row for row in score.figures if row.figure != "truth_error")
        noisy = replace(score, figures=(*exact, figure_row("truth_error", value=0.01)))
        results.append((str(number), noisy))
    terms = {"prob": 0.95, "confidence": 0.95, "interpretation": "ensemble"}
    bound = group_of("position_bound_m", {**terms, "limit": 10.0}, results).value
    for beyond, state in ((0.02, "not enough data"), (0.04, "pass")):  # 1.96 sqrt(2) 0.01 m
        found = group_of("position_bound_m", {**terms, "limit": bound + beyond}, results)
        assert (found.state, found.over) == (state, "all drives")


def test_a_sequential_decision_reads_each_result_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store, jobs = Store(tmp_path), [dataclasses.replace(JOB, repeat=number) for number in range(3)]
    store.save_plan(jobs)
    read: list[str] = []
    score_of_job = Store.score

    def counted(self: Store, job: Job) -> Score:
        read.append(job.key)
        return score_of_job(self, job)

    def save(job: Job) -> None:
        provenance = Provenance(version="", configuration={"suite.key": job.key})
        store.save(job, JobOutcome(result=to_json(Score(figures=(), provenance=provenance))))

    save(jobs[0])
    monkeypatch.setattr(Store, "score", counted)
    decision = SequentialDecision(store)
    for job in jobs[1:]:
        save(job)
        decision.add(job)
        assert not decision.is_made, "no limit is decided"
    assert read == [job.key for job in jobs]
