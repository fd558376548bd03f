"""Tolerance bounds: against published tables, the order of values, simulated campaigns, and as limits."""

from functools import cache
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace
from scipy import stats

from campaigns.tolerance_coverage import coverage
from helpers.random_drives import drive, score_of
from sfr_loc_map.errors import ConfigError
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.figures.rows import figure_row
from sfr_loc_map.metrics.judging import judge, limits_file, reasons
from sfr_loc_map.metrics.judging.proof import prove_sample
from sfr_loc_map.metrics.score.limits import Population, Terms
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.statistics import tolerance
from sfr_loc_map.metrics.statistics.tolerance import Sample
from sfr_loc_map.metrics.stored.file_check import fault_of_verdicts

SHAPES = (1.0, 1.0, 1.0), (1.0, 0.3, 0.3), (1.0, 0.0, 0.0)
RANDOM = np.random.default_rng(1)


@pytest.mark.parametrize(("prob", "expected"), [(0.9973, (0.98, 0.67, 0.54)), (0.95, (1.0, 0.96, 0.88))])
def test_what_mean_plus_3_sigma_of_five_errors_proves(prob: float, expected: tuple[float, ...]) -> None:
    """An isotropic error, one that is oblong and one along an axis, against samples drawn here."""
    for shape, confidence in zip(SHAPES, expected, strict=True):
        errors = RANDOM.standard_normal((40_000, 5, 3)) * shape
        figure = np.linalg.norm(errors.mean(axis=1), axis=1) + 3 * np.linalg.norm(errors.std(axis=1, ddof=1), axis=1)
        radius = np.quantile(np.linalg.norm(RANDOM.standard_normal((1_000_000, 3)) * shape, axis=1), prob)
        found = tolerance.confidence_of(3.0, 5.0, shape, prob, zero_mean=True)
        assert found == pytest.approx(np.mean(figure >= radius), abs=0.01)
        assert found == pytest.approx(confidence, abs=0.01)
        assert tolerance.confidence_of(3.0, 5.0, shape, prob) <= found + 1e-9
    assert tolerance.confidence_of(3.0, 1.9, SHAPES[0], prob) is None


def test_zero_failure_sizes_are_those_of_the_tables() -> None:
    """Wilks' numbers; each number of failures against the binomial law."""
    sizes = [tolerance.zero_failure_count(*each) for each in ((0.95, 0.95), (0.99, 0.95), (0.9973, 0.9))]
    assert sizes == [59, 299, 852]
    for count in (58, 59, 93, 300):
        failures = tolerance.allowed_failures(count, 0.95, 0.95)
        assert stats.binom.cdf(failures + 1, count, 0.05) > 0.05
        assert failures < 0 or stats.binom.cdf(failures, count, 0.05) <= 0.05
    assert tolerance.count_for_rate(0, 12, 0.95, 0.95) == 59
    assert tolerance.count_for_rate(1, 10, 0.95, 0.95) is None
    needed = tolerance.count_for_rate(1, 50, 0.95, 0.95)
    assert tolerance.allowed_failures(needed, 0.95, 0.95) >= needed / 50 > 1


@pytest.mark.parametrize(
    ("failures", "count", "prob", "confidence"),
    [(2, 50, 0.95, 0.95), (3, 137, 0.95, 0.95), (5, 137, 0.95, 0.95), (1, 20, 0.9, 0.9), (2, 200, 0.95, 0.95)],
)
def test_no_smaller_number_of_values_at_the_observed_rate_suffices(
    failures: int, count: int, prob: float, confidence: float
) -> None:
    rate = failures / count
    counts = np.arange(count, 3000)
    suffices = stats.binom.cdf(np.ceil(rate * counts - 1e-9), counts, 1.0 - prob) <= 1.0 - confidence
    assert tolerance.count_for_rate(failures, count, prob, confidence) == counts[suffices][0]


def test_normality_has_its_level_and_detects_heavy_tails() -> None:
    accepted = [tolerance.normality(RANDOM.standard_normal(40)) >= 0.25 for _ in range(2000)]
    assert np.mean(accepted) == pytest.approx(0.75, abs=0.04)
    heavy = [tolerance.normality(RANDOM.standard_t(3, 200)) >= 0.25 for _ in range(500)]
    assert np.mean(heavy) < 0.02


@pytest.mark.parametrize(
    ("case", "count", "is_normal"),
    [
        ("isotropic", 20, True),
        ("one axis", 5, True),
        ("1 : 0.3 : 0.3", 200, False),
        ("heavy tails, one axis", 200, False),
        ("correlated windows", 60, False),
        ("heavy tails, overlap 1.5", 200, False),
    ],
)
def test_bounds_hold_as_often_as_they_say(case: str, count: int, is_normal: bool) -> None:
    """200 campaigns: three standard deviations below the confidence; the campaign of 10,000 is tolerance-coverage."""
    found = coverage(case, count, 0.95, 0.95, 200, is_normal=is_normal)
    assert found.stated > 0.99
    assert found.held > 0.95 - 3 * np.sqrt(0.05 * 0.95 / 200)
    assert found.accused < 0.05 + 3 * np.sqrt(0.05 * 0.95 / 200)


def test_the_number_that_is_needed_is_enough() -> None:
    sample = Sample(RANDOM.standard_normal(400), 400.0)
    known = tolerance.moments(sample)
    needed = tolerance.normal_count(known, known.mean + 3.3 * known.sigma, 0.9973, 0.9)
    factors = [tolerance.normal_factor(float(n), known.shape, 0.9973, 0.9) for n in (needed - 1, needed)]
    assert factors[0] > 3.3 >= factors[1]
    few = Sample(RANDOM.standard_normal(20), 20.0)
    assert tolerance.tolerance_bound(few, 0.95, 0.95).upper is None
    assert tolerance.count_needed(few, 100.0, 0.95, 0.95) == 59
    assert tolerance.count_needed(few, 0.0, 0.95, 0.95) is None


def test_a_fractional_overlap_needs_as_many_values_as_each_series_lacks() -> None:
    """Of 80 errors with an overlap of 1.25, each of the two series has 40 of the 59 that are needed."""
    sample = Sample(RANDOM.standard_normal(80), 64.0)
    assert tolerance.order_bounds(sample, 0.95, 0.95)[0] is None
    terms = Terms(prob=0.95, confidence=0.95, interpretation=Population.TEMPORAL)
    assert prove_sample(terms, 100.0, sample).record.more == 19


@pytest.mark.parametrize("beyond", [0, 8])
def test_errors_beyond_the_limit_by_less_than_the_error_of_the_truth_fail_nothing(beyond: int) -> None:
    """A fail is decided by the lower bound, whatever the upper bound is."""
    terms = Terms(prob=0.95, confidence=0.95, interpretation=Population.TEMPORAL)
    errors = np.array([0.101] * (92 if beyond else 20) + [0.5] * beyond)
    sample = Sample(errors, float(len(errors)))
    assert prove_sample(terms, 0.1, sample).state == "fail"
    assert prove_sample(terms, 0.1, sample, truth_error=0.05).state == "not enough data"


# ---- as limits


def judged(score: Score, **entry: Any) -> tuple[Score, Any]:
    content = {"trajectory": [{"condition": "distance=5", "position_bound_m": entry}]}
    found = judge.judged_by(score, limits_file.parse_limits(content, "limits"))
    return found, found.verdicts[0]


@cache
def long_score() -> Score:
    """A drive of 238 sub-trajectories with an overlap of 2.2, three series of some 80 that share no frame."""
    truth, estimate = drive(3, count=2400)
    return score_of(estimate, truth, TrajectoryScoreConfig(conditions=("distance=5",)))


def test_a_limit_with_a_share_passes_fails_or_says_how_many_drives_are_missing() -> None:
    score = long_score()
    independent = score.figure("position").independent
    assert independent > 59
    found, verdict = judged(score, limit=10.0, prob=0.95, confidence=0.95)
    assert (verdict.state, verdict.proof.more, verdict.n) == ("pass", None, score.figure("position").n)
    assert verdict.proof.independent == independent
    row = found.rows("bound")[0]
    assert row.value == verdict.value < 10.0
    assert score.figure("position").p95 < row.value <= score.figure("position").max
    assert row.unit == "m"
    again = judge.judged_by(found, found.rules)
    assert again.rows("bound") == found.rows("bound"), "judged again, the table has the bound once"
    assert judged(score, limit=0.0, prob=0.95, confidence=0.95)[1].state == "fail"
    _, ensemble = judged(score, limit=10.0, prob=0.95, confidence=0.95, interpretation="ensemble")
    assert (ensemble.state, ensemble.proof.more) == ("not enough data", 58)
    of_drives = judged(score, limit=10.0, interpretation="mixed", prob=0.95, confidence=0.95)[0]
    assert "58 more drives" in reasons.reasons_not_judged(of_drives)[0]
    without = judged(replace(score, details=None), limit=10.0)[1]
    assert (without.state, without.value) == ("not enough data", None)


def test_limits_with_equal_terms_have_one_bound_and_other_terms_another_row() -> None:
    terms = {"limit": 10.0, "prob": 0.95, "confidence": 0.95}
    bounds = [terms, {**terms, "limit": 20.0, "id": "B"}, {**terms, "normal": True}]
    entries = [{"condition": "distance=5", "position_bound_m": bound} for bound in bounds]
    found = judge.judged_by(long_score(), limits_file.parse_limits({"trajectory": entries}, "limits"))
    first, other = found.rows("bound")
    assert first.keys != other.keys
    assert [found.row_of(verdict) for verdict in found.on_limits] == [first, first, other]


def test_a_bound_of_another_release_of_scipy_is_the_same_but_for_rounding() -> None:
    found, _ = judged(long_score(), limit=10.0, prob=0.95, confidence=0.95)
    for factor, is_refused in ((1.0 + 1e-12, False), (1.0 + 1e-6, True)):
        rows = [replace(row, value=factor * row.value) if row.figure == "bound" else row for row in found.figures]
        problem = fault_of_verdicts(replace(found, figures=tuple(rows)), found)
        assert (problem is not None) == is_refused, problem


def test_a_tolerance_bound_within_the_error_of_the_truth_decides_nothing() -> None:
    score = long_score()
    bound = judged(score, limit=10.0, prob=0.95, confidence=0.95)[1].value
    exact = tuple(row for row in score.figures if row.figure != "truth_error")
    noisy = replace(score, figures=(*exact, figure_row("truth_error", value=0.01)))
    error = 1.96 * np.sqrt(2.0) * 0.01  # 95 % of the errors
    for beyond, state in ((0.99, "not enough data"), (1.01, "pass")):
        terms = {"limit": bound + beyond * error, "prob": 0.95, "confidence": 0.95}
        found, verdict = judged(noisy, **terms)
        assert (verdict.state, verdict.truth_error) == (state, pytest.approx(error, rel=1e-4))
        assert found.row_of(verdict) is found.rows("bound")[0]
        assert judged(replace(score, figures=exact), **terms)[1].state == "pass"
        if state != "pass":
            assert "within the error of the truth" in reasons.why_open(verdict, found)


@pytest.mark.parametrize(
    ("entry", "problem"),
    [
        ({"prob": 95}, "0.95 for 95 %"),
        ({"confidence": "high"}, "confidence"),
        ({"interpretation": "always"}, "temporal, ensemble, mixed"),
        ({"normal": "yes"}, "true or false"),
        ({"share": 0.9}, "unknown key 'share'"),
    ],
)
def test_terms_that_make_no_sense_are_refused(entry: dict[str, Any], problem: str) -> None:
    content = {"trajectory": [{"condition": "distance=5", "position_bound_m": {"limit": 1, **entry}}]}
    with pytest.raises(ConfigError, match=problem):
        limits_file.parse_limits(content, "limits")
    with pytest.raises(ConfigError, match="unknown key 'prob'"):
        limits_file.parse_limits(
            {"trajectory": [{"condition": "distance=5", "position_max_m": {"limit": 1, "prob": 0.9}}]}, "l"
        )


def test_every_report_says_what_mean_plus_3_sigma_proves() -> None:
    score = long_score()
    rows = score.rows("confidence", condition="distance=5")
    assert [row.part for row in rows] == ["99.73 % of position errors", "95 % of position errors"]
    assert 0.5 < rows[0].value < rows[1].value <= 1.0
    assert rows[0].independent == score.figure("position").independent
    ratios = [row.value for row in score.rows("shape")]
    assert 1.0 >= ratios[0] >= ratios[1] >= 0.0
