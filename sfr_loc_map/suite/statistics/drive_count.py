"""`sfr suite plan`: the number of drives required to prove a requirement, from its terms and from observed errors.

A fixed plan decides after all drives, and the course of the sequential test is its expected number of drives.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.metrics.config import VerdictState
from sfr_loc_map.metrics.judging.proof import SequentialTest, sample_over_drives, sequential_test
from sfr_loc_map.metrics.score.limits import BOUND, Limits, Population, Terms
from sfr_loc_map.metrics.statistics.tolerance import count_needed, moments, normal_count, zero_failure_count
from sfr_loc_map.report.verdict_view import limited_name
from sfr_loc_map.suite.statistics.group_verdicts import samples_by_drive
from sfr_loc_map.suite.statistics.groups import by_group
from sfr_loc_map.suite.statistics.scored_job import ScoredJob

MOST_DRIVES = 100_000  #: Maximum number of drives of a plan.
OVERRUN = 4
"""The expected number of drives is computed for up to this multiple of the number of drives of the fixed plan."""


class DriveCount(Struct, frozen=True, kw_only=True):
    """The number of drives needed to prove a requirement. A field is None if unknown or if no number suffices."""

    group: str  #: Group of the suite; empty without a suite.
    limit: str  #: Name of the limit; empty without a suite.
    prob: float
    confidence: float
    power: float
    good: float  #: Acceptable failure rate.
    without_failure: int  #: Required number of drives if none fails.
    fixed: int  #: Required number of drives with the given power if the number is fixed in advance.
    allowed: int  #: Number of failures that are allowed in this fixed number of drives.
    sequential: float  #: Expected number of drives of the sequential test at the failure rate `good`.
    sequential_at_none: float  #: Expected number of drives of the sequential test if none fails.
    drives: int | None = None  #: Number of drives in the suite.
    failures: int | None = None  #: Number of drives in the suite that exceed the limit.
    at_the_rate_seen: int | None = None  #: Required number of drives at the observed failure rate.
    if_normal: int | None = None  #: Required number of drives for normal errors with the observed moments.
    state: VerdictState | None = None  #: Decision of the sequential test.

    @property
    def text(self) -> str:
        """The requirement in words."""
        terms = f"{100.0 * self.prob:g} % with {100.0 * self.confidence:g} %, power {100.0 * self.power:g} % at "
        terms += f"{100.0 * self.good:g} % failures"
        return ": ".join(text for text in (self.group, self.limit, terms) if text)


def count_without_suite(terms: Terms) -> DriveCount:
    """Return the number of drives that terms require."""
    test = sequential_test(terms)
    plan = fixed_plan(test)
    return DriveCount(
        group="",
        limit="",
        prob=terms.prob,
        confidence=terms.confidence,
        power=test.power,
        good=test.good,
        without_failure=zero_failure_count(terms.prob, terms.confidence),
        fixed=plan.drives,
        allowed=plan.allowed,
        sequential=course_of(test, test.good).drives,
        sequential_at_none=course_of(test, 0.0).drives,
    )


def drive_counts(results: Sequence[ScoredJob], limits: Limits | None) -> Iterator[DriveCount]:
    """Yield the number of drives for each group and limit with `prob`; raise ConfigError if no limit has `prob`."""
    given = () if limits is None else limits.limits
    chosen = [(limit, limit.terms) for limit in given if limit.terms is not None]
    if not chosen:
        raise ConfigError(
            "the number of drives is computed for limits with 'prob', but the suite has no such limit: add one, such "
            "as position_bound_m: {limit: 0.1, prob: 0.95}"
        )
    for key, members in by_group(results).items():
        for limit, terms in chosen:
            samples, _ = samples_by_drive(limit, members)
            if not samples:
                continue
            interpretation = terms.interpretation
            if interpretation is Population.TEMPORAL:  # a single drive is not a sample of drives
                interpretation = Population.ENSEMBLE
            sample = sample_over_drives(interpretation, samples)
            known = moments(sample)
            has_failed = sample.sizes > limit.limit
            yield replace(
                count_without_suite(terms),
                group=key.text,
                limit=f"{limited_name(limit.limited.figure, None, limit.condition, BOUND)}, {interpretation}",
                drives=len(sample.errors),
                failures=int(has_failed.sum()),
                at_the_rate_seen=count_needed(sample, limit.limit, terms.prob, terms.confidence),
                if_normal=None if known is None else normal_count(known, limit.limit, terms.prob, terms.confidence),
                state=sequential_test(terms).decision_over_all(has_failed.tolist())[0],
            )


# ---- the number of drives of a test with given error rates (`judging.proof`)


class FixedPlan(NamedTuple):
    """A number of drives, and the allowed number of failures."""

    drives: int
    allowed: int


class Course(NamedTuple):
    """The expected course of a sequential test."""

    drives: float  #: Expected number of drives.
    passed: float  #: Probability of a pass.
    failed: float  #: Probability of a fail.


def fixed_plan(test: SequentialTest) -> FixedPlan:
    """Return the plan with the fewest drives that has the error rates of a test; ConfigError above `MOST_DRIVES`.

    It passes with a probability of at most `1 - confidence` at the failure fraction `bad`, and of at least `power` at
    `good`.
    """
    from scipy.special import bdtr

    allowed, drives = 0, 1
    while drives <= MOST_DRIVES:
        while bdtr(allowed, drives, test.bad) > 1.0 - test.confidence:
            drives += 1
        if bdtr(allowed, drives, test.good) >= test.power:
            return FixedPlan(drives, allowed)
        allowed += 1
    shares = f"distinguish a failure fraction of {100.0 * test.good:g} % ('good') from {100.0 * test.bad:g} %"
    raise ConfigError(f"more than {MOST_DRIVES} drives are required to {shares}: give a smaller 'good'")


def course_of(test: SequentialTest, share: float) -> Course:
    """Return the exact probabilities of the outcomes for a true fraction of failures."""
    longest = OVERRUN * fixed_plan(test).drives
    alive = np.array([1.0])
    passed = failed = expected = 0.0
    for drives in range(1, longest + 1):
        expected += float(alive.sum())
        alive = np.concatenate((alive * (1.0 - share), [0.0])) + np.concatenate(([0.0], alive * share))
        for failures in np.flatnonzero(alive > 0.0):
            state = test.state(int(failures), drives)
            if state is VerdictState.NOT_ENOUGH_DATA:
                continue
            passed += float(alive[failures]) if state is VerdictState.PASS else 0.0
            failed += float(alive[failures]) if state is VerdictState.FAIL else 0.0
            alive[failures] = 0.0
        if alive.sum() < 1e-9:
            break
        alive = np.where(alive > 1e-15, alive, 0.0)
    return Course(expected, passed, failed)
