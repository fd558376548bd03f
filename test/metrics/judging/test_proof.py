"""Plans and sequential tests: error rates against the binomial law and against simulated campaigns."""

import numpy as np
import pytest
from scipy import stats

from sfr_loc_map.metrics.config import VerdictState
from sfr_loc_map.metrics.judging.proof import SequentialTest, prove
from sfr_loc_map.metrics.score.limits import Population, Terms
from sfr_loc_map.metrics.statistics.tolerance import Sample, zero_failure_count
from sfr_loc_map.suite.statistics.drive_count import course_of, fixed_plan

TEST = SequentialTest(good=0.01, bad=0.05, confidence=0.95, power=0.9)


def test_the_fixed_plan_is_the_smallest_that_keeps_both_risks() -> None:
    drives, allowed = fixed_plan(TEST)
    assert stats.binom.cdf(allowed, drives, TEST.bad) <= 0.05
    assert stats.binom.cdf(allowed, drives, TEST.good) >= 0.9
    assert stats.binom.cdf(allowed, drives - 1, TEST.bad) > 0.05
    smaller = int(stats.binom.isf(0.1, drives, TEST.good)) - 1
    assert smaller < allowed, "with fewer failures allowed good drives would fail"
    none = fixed_plan(SequentialTest(0.0, 0.05, 0.95, 0.9))
    assert none == (zero_failure_count(0.95, 0.95), 0)


@pytest.mark.parametrize("share", [0.0, 0.01, 0.05, 0.2])
def test_the_course_is_that_of_simulated_campaigns(share: float) -> None:
    rng = np.random.default_rng(7)
    longest = 4 * fixed_plan(TEST).drives
    ends = [TEST.decision((rng.random(longest) < share).tolist()) for _ in range(1500)]
    course = course_of(TEST, share)
    assert np.mean([drives for _, drives in ends]) == pytest.approx(course.drives, rel=0.06)
    passed = np.mean([state is VerdictState.PASS for state, _ in ends])
    assert passed == pytest.approx(course.passed, abs=0.03)
    assert course.passed + course.failed == pytest.approx(1.0, abs=0.01)


def test_the_risks_are_kept_and_drives_are_saved() -> None:
    """40 % of the fixed plan are saved where drives are clearly good or bad; at the border `good` it is less."""
    fixed = fixed_plan(TEST).drives
    assert course_of(TEST, TEST.bad).passed <= 0.05
    assert course_of(TEST, TEST.good).failed <= 0.1
    saved = {share: 1.0 - course_of(TEST, share).drives / fixed for share in (0.0, 0.01, 0.05, 0.1)}
    assert min(saved[0.0], saved[0.05], saved[0.1]) > 0.4
    assert saved[0.01] > 0.25


def test_drives_are_judged_after_each_of_them() -> None:
    terms = Terms(prob=0.95, confidence=0.95, interpretation=Population.ENSEMBLE, good=0.01, power=0.9)
    drives = {str(number): [Sample(np.full((5, 3), 0.01), 1.0)] for number in range(80)}
    passed = prove(terms, 0.1, drives)
    assert (passed.state, passed.record.independent) == ("pass", TEST.more_without_failure(0, 0))
    open_yet = prove(terms, 0.1, dict(list(drives.items())[:60]))
    assert (open_yet.state, open_yet.record.more) == ("not enough data", 13)
    failed = prove(terms, 0.001, drives)
    assert (failed.state, failed.record.independent) == ("fail", 2)


@pytest.mark.parametrize("interpretation", [*Population])
def test_an_unknown_error_proves_nothing(interpretation: Population) -> None:
    good = None if interpretation is Population.TEMPORAL else 0.01
    terms = Terms(prob=0.9, confidence=0.9, interpretation=interpretation, good=good, power=0.9)
    known = {str(number): [Sample(np.full((5, 1), 0.01), 5.0)] for number in range(99)}
    unknown = {name: [Sample(np.full((5, 1), np.nan), 5.0)] for name in known}
    for drives in (unknown, {**known, "one": [Sample(np.array([[0.01], [np.nan]]), 2.0)]}):
        found = prove(terms, 0.1, drives)
        assert (found.state, found.bound) == ("not enough data", None)


def test_no_number_of_drives_passes_after_a_failure_if_no_failure_is_acceptable() -> None:
    """The error of the truth leaves the failure undecided."""
    terms = Terms(prob=0.9, confidence=0.9, interpretation=Population.ENSEMBLE, good=0.0)
    proof = prove(terms, 0.1, {"": [Sample(np.array([0.101]), 1.0)]}, truth_error=0.05)
    assert (proof.state, proof.record.more) == (VerdictState.NOT_ENOUGH_DATA, None)


def test_the_order_of_drives_draws_no_other_errors() -> None:
    rng = np.random.default_rng(1)
    drives = {str(number): [Sample(rng.random((50, 3)), 50.0)] for number in range(30)}
    terms = Terms(prob=0.9, confidence=0.9, interpretation=Population.MIXED)
    reverse = dict(reversed(drives.items()))
    assert prove(terms, 1.0, drives).bound == prove(terms, 1.0, reverse).bound


def test_a_sequential_test_takes_drives_in_their_order() -> None:
    """Drives after those that decide do not change the decision."""
    terms = Terms(prob=0.5, confidence=0.5, interpretation=Population.ENSEMBLE, power=0.5, good=0.1)
    errors = {"a": 0.1, "b": 0.1, "c": 9.0}
    for order, decision in (("abc", (VerdictState.PASS, 2, 0.1)), ("cba", (VerdictState.FAIL, 1, 9.0))):
        proof = prove(terms, 1.0, {name: [Sample(np.full(5, errors[name]), 5.0)] for name in order})
        assert (proof.state, proof.n, proof.bound) == decision


def test_good_drives_at_the_beginning_do_not_hide_a_failure_over_all_drives() -> None:
    terms = Terms(prob=0.5, confidence=0.5, interpretation=Population.ENSEMBLE, power=0.5, good=0.1)
    drives = {name: [Sample(np.full(5, error), 5.0)] for name, error in zip("abcd", (0.1, 0.1, 9.0, 9.0), strict=True)}
    assert prove(terms, 1.0, {name: drives[name] for name in "ab"}).state is VerdictState.PASS
    proof = prove(terms, 1.0, drives)
    assert (proof.state, proof.n, proof.bound) == (VerdictState.FAIL, 4, 9.0)


def test_drives_within_the_error_of_the_truth_decide_neither_pass_nor_fail_over_all_drives() -> None:
    """They fail together with the error of the truth added, and pass with it subtracted."""
    terms = Terms(prob=0.5, confidence=0.5, interpretation=Population.ENSEMBLE, power=0.5, good=0.1)
    drives = {
        name: [Sample(np.full(5, error), 5.0)] for name, error in zip("abcd", (0.1, 0.1, 1.05, 1.05), strict=True)
    }
    assert prove(terms, 1.0, drives).state is VerdictState.FAIL
    assert prove(terms, 1.0, drives, truth_error=0.1).state is VerdictState.NOT_ENOUGH_DATA
    drives |= {name: [Sample(np.full(5, 0.95), 5.0)] for name in "cd"}
    assert prove(terms, 1.0, drives, truth_error=0.1).state is VerdictState.NOT_ENOUGH_DATA


def test_a_failure_never_helps_drives_that_are_within_the_error_of_the_truth() -> None:
    terms = Terms(prob=0.9, confidence=0.9, interpretation=Population.ENSEMBLE, good=0.02)
    near = {f"{number:03}": [Sample(np.array([0.0999]), 1.0)] for number in range(80)}
    far = {name: [Sample(np.array([0.05]), 1.0)] for name in near}
    one_failed = {**near, "000": [Sample(np.array([0.5]), 1.0)]}
    assert prove(terms, 0.1, far, truth_error=0.01).state is VerdictState.PASS
    for drives in (near, one_failed):
        assert prove(terms, 0.1, drives, truth_error=0.01).state is VerdictState.NOT_ENOUGH_DATA
