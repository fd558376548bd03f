"""Verdicts over the drives of a group: a bound with a confidence, and figures that cannot be pooled."""

from __future__ import annotations

import functools

import pytest
from msgspec.structs import replace

from helpers.made_suites import scored_job
from helpers.random_drives import drive, score_of
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.figures.details import ErrorRows
from sfr_loc_map.metrics.figures.records import MethodKind, MethodRecord
from sfr_loc_map.metrics.figures.rows import figure_row
from sfr_loc_map.metrics.judging.limits_file import parse_limits
from sfr_loc_map.metrics.judging.proof import sample_of
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.suite.statistics.group_verdicts import GroupVerdict, verdicts_over
from sfr_loc_map.suite.statistics.pooling import pool
from sfr_loc_map.suite.statistics.scored_job import ScoredJob


@functools.cache
def scored(seed: int, count: int = 60, condition: str = "distance=5") -> Score:
    """Return the score of a random drive by one condition."""
    truth, estimate = drive(seed, count=count)
    return score_of(estimate, truth, TrajectoryScoreConfig(conditions=(condition,)))


def test_a_limit_with_a_share_over_drives_by_each_interpretation() -> None:
    """30 short drives prove 90 % with 95 %, one value a drive. No single drive does; one bad drive is too many."""
    results = [scored_job(str(number), scored(number)) for number in range(30)]
    terms = {"prob": 0.9, "confidence": 0.95}

    def verdict(interpretation: str, chosen: list[ScoredJob], limit: float = 10.0) -> GroupVerdict:
        entry = {**terms, "limit": limit, "interpretation": interpretation}
        content = {"trajectory": [{"condition": "distance=5", "position_bound_m": entry}]}
        (found,) = verdicts_over(parse_limits(content, "limits"), chosen, ())
        return found

    passed = verdict("ensemble", results)
    assert (passed.state, passed.n, passed.missed_by, passed.over) == ("pass", 30, 0, "all drives")
    largest = sorted(float(sample_of(result.score, "position", "distance=5").sizes.max()) for result in results)
    assert passed.value == pytest.approx(largest[-1])
    mixed = verdict("mixed", results)
    assert (mixed.state, mixed.n) == ("pass", 30)
    assert mixed.value <= passed.value
    one_bad = verdict("ensemble", results, limit=0.5 * (largest[-1] + largest[-2]))
    assert (one_bad.state, one_bad.missed_by) == ("not enough data", 1)
    assert one_bad.proof.more > 15
    assert verdict("ensemble", results, limit=0.0).state == "fail"
    few = verdict("ensemble", results[:20])
    assert (few.state, few.proof.more) == ("not enough data", 9)
    repeats = verdict("ensemble", [*results[:20], *[scored_job("0", result.score) for result in results[20:]]])
    assert (repeats.state, repeats.n) == ("not enough data", 20), "repeats are one drive"
    assert verdict("temporal", results).state == "not enough data"


def group_of(limit: str, bound: object, results: list[ScoredJob]) -> GroupVerdict:
    """The verdict on one limit over drives."""
    content = {"trajectory": [{"condition": "distance=5", limit: bound}]}
    rows = tuple(row for row in pool(results, "distance=5"))
    (found,) = verdicts_over(parse_limits(content, "limits"), results, rows)
    return found


def test_a_result_with_calls_but_without_the_estimate_makes_the_verdicts_of_its_group_incomplete() -> None:
    """A drive must not meet a limit by the absence of its estimate. A cloud without calls is not a drive."""
    results = [scored_job(str(number), scored(number)) for number in range(30)]
    calls, cloud = (
        Score(figures=(figure_row("judged", None, part, n=60, value=1.0),)) for part in ("calls localisation", "map")
    )
    bound = {"prob": 0.9, "confidence": 0.95, "limit": 10.0, "interpretation": "ensemble"}
    for limit, value in (("position_mean_plus_3sigma_m", 10.0), ("position_max_m", 10.0), ("position_bound_m", bound)):
        assert group_of(limit, value, results).state == "pass"
        assert group_of(limit, value, [*results, scored_job("absent", calls)]).state == "incomplete"
        assert group_of(limit, value, [*results, scored_job("cloud", cloud)]).state == "pass"


@pytest.mark.parametrize("statistic", ["rmse", "p50", "p95", "p99", "max"])
def test_a_limit_on_a_statistic_that_drives_do_not_pool_is_that_of_the_worst_drive(statistic: str) -> None:
    results = [scored_job(str(number), scored(number, 200)) for number in range(4)]
    values = [result.score.number("position", statistic, condition="distance=5") for result in results]
    for factor, state in ((1.01, "pass"), (0.99, "fail")):
        found = group_of(f"position_{statistic}_m", factor * max(values), results)
        assert (found.state, found.over, found.value, found.row) == (state, "worst drive", max(values), None)
        missed = sum(value > factor * max(values) for value in values)
        assert (found.missed_by, found.n) == (missed, sum(result.score.figure("position").n for result in results))
    repeats = group_of(f"position_{statistic}_m", 0.0, [*results, results[0]])
    assert repeats.missed_by == 4, "a repeat is the same drive"
    short = scored(0, 80)
    few = group_of(f"position_{statistic}_m", 10.0, [scored_job("short", short)])
    assert (few.state, few.over) == ("not enough data", "worst drive"), short.figure("position").independent


def test_a_bound_over_drives_within_the_error_of_the_truth_decides_nothing() -> None:
    results = []
    for number in range(30):
        score = scored(number)
        exact = tuple(row for row in score.figures if row.figure != "truth_error")
        noisy = replace(score, figures=(*exact, figure_row("truth_error", value=0.01)))
        results.append(scored_job(str(number), noisy))
    terms = {"prob": 0.9, "confidence": 0.95, "interpretation": "ensemble"}
    bound = group_of("position_bound_m", {**terms, "limit": 10.0}, results).value
    for beyond, state in ((0.02, "not enough data"), (0.04, "pass")):  # 1.96 sqrt(2) 0.01 m
        found = group_of("position_bound_m", {**terms, "limit": bound + beyond}, results)
        assert (found.state, found.over) == (state, "all drives")


@pytest.mark.parametrize("interpretation", ["ensemble", "mixed", "temporal"])
@pytest.mark.parametrize("lack", ["short", "unknown", "thinned"])
def test_a_drive_that_lacks_errors_makes_a_proof_incomplete(interpretation: str, lack: str) -> None:
    results = [scored_job(str(number), scored(number, condition="distance=1")) for number in range(12)]
    terms = {"limit": 10.0, "prob": 0.5, "confidence": 0.5, "interpretation": interpretation}
    limits = parse_limits({"trajectory": [{"condition": "distance=1", "position_bound_m": terms}]}, "limits")
    assert [item.state for item in verdicts_over(limits, results, ())] == ["pass"]
    (*_, found) = verdicts_over(limits, [*results, scored_job("99", lacking(results[0].score, lack))], ())
    assert (found.name, found.state) == ("position_bound_m", "incomplete")


def lacking(score: Score, lack: str) -> Score:
    """A score without sub-trajectories, with an unknown error, or with a part of the errors."""
    if lack == "short":
        return scored(0, 2, "distance=1")
    errors = score.all_errors("position", "distance=1")
    details = replace(score.details, trajectory=replace(score.details.trajectory, sub_trajectories=()))
    columns = tuple((None, *values[1:]) for values in errors.T.tolist())
    rows = (ErrorRows(figure="position", condition="distance=1", errors=columns),) if lack == "unknown" else ()
    return replace(score, details=details, errors=rows)


def test_a_sequential_test_ends_before_a_drive_that_lacks_errors() -> None:
    """The test passes after 6 drives: a drive that lacks errors prevents the decision only if it is one of them."""
    scores = [scored(number, condition="distance=1") for number in range(12)]
    terms = {"limit": 10.0, "prob": 0.75, "confidence": 0.75, "power": 0.75, "good": 0.05, "interpretation": "ensemble"}
    limits = parse_limits({"trajectory": [{"condition": "distance=1", "position_bound_m": terms}]}, "limits")
    for number, state in ((3, "incomplete"), (9, "pass")):
        results = [scored_job(str(k), score) for k, score in enumerate(scores)]
        results.sort(key=lambda result: result.drive_key)  # the order of a sequential test
        results[number] = scored_job(results[number].job.source.name, lacking(results[number].score, "thinned"))
        (found,) = verdicts_over(limits, results, ())
        assert found.state == state


@pytest.mark.parametrize(("methods", "state"), [(("mine", "mine"), None), (("mine", "other"), "not judged")])
def test_drives_of_two_items_under_test_have_no_common_verdict(methods: tuple[str, str], state: str | None) -> None:
    results = []
    for number, name in enumerate(methods):
        method = MethodRecord(name=name, version="1", kind=MethodKind.PYTHON)
        results.append(scored_job(str(number), replace(scored(number), method=method)))
    found = {verdict.name: verdict.state for verdict in verdicts_over(None, results, ())}
    assert found.get("items_under_test_max") == state
