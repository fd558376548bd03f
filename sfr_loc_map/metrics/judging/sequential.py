"""Tests of a fraction of failures with given error rates: the number of drives of a campaign, and when it may stop.

A method whose fraction of failures is `bad` passes with a probability of at most `1 - confidence`. A method whose
fraction is `good`, which is acceptable, fails with a probability of at most `1 - power`. A fixed plan decides after all
drives. Wald's sequential probability ratio test (1945) is evaluated after each drive. The bounds `1 / risk` of the test
keep both risks for any stopping time (Ville 1939).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.metrics.config import VerdictState
from sfr_loc_map.metrics.score.limits import Terms
from sfr_loc_map.metrics.statistics.tolerance import CONFIDENCE

MOST_DRIVES = 100_000  #: Maximum number of drives of a plan.
OVERRUN = 4  #: Multiple of the fixed plan up to which the expected number of drives is computed.


class FixedPlan(NamedTuple):
    """A number of drives, and the allowed number of failures."""

    drives: int
    allowed: int


class SequentialTest(NamedTuple):
    """The acceptable and the unacceptable fraction of failures, and the confidence and power of the test."""

    good: float
    bad: float
    confidence: float  #: A campaign with the fraction `bad` passes with a probability of at most `1 - confidence`.
    power: float  #: A campaign with the fraction `good` fails with a probability of at most `1 - power`.

    def ratio(self, failures: float, drives: float) -> float:
        """Return the logarithm of the likelihood ratio of `bad` to `good`."""
        passed = (drives - failures) * math.log((1.0 - self.bad) / (1.0 - self.good))
        if not failures:
            return passed
        return passed + failures * (math.log(self.bad / self.good) if self.good > 0.0 else math.inf)

    def state(self, failures: float, drives: float) -> VerdictState:
        """Return the decision after this number of drives and failures."""
        ratio = self.ratio(failures, drives)
        if ratio <= math.log(1.0 - self.confidence):
            return VerdictState.PASS
        return VerdictState.FAIL if ratio >= -math.log(1.0 - self.power) else VerdictState.NOT_ENOUGH_DATA

    def decision(self, has_failed: Iterable[bool]) -> tuple[VerdictState, int]:
        """Return the first decision over the drives in order, and the number of drives up to the decision."""
        failures = drives = 0
        for failed in has_failed:
            drives += 1
            failures += failed
            state = self.state(failures, drives)
            if state is not VerdictState.NOT_ENOUGH_DATA:
                return state, drives
        return VerdictState.NOT_ENOUGH_DATA, drives

    def more_without_failure(self, failures: int, drives: int) -> int | None:
        """Return the number of additional drives without a failure that lead to a pass; None if no number suffices."""
        if failures and not self.good:
            return None
        step = self.ratio(0, 1)
        missing = (math.log(1.0 - self.confidence) - self.ratio(failures, drives)) / step
        return max(math.ceil(missing - 1e-9), 1)

    def fixed_plan(self) -> FixedPlan:
        """Return the smallest plan that keeps both risks; ConfigError if it exceeds `MOST_DRIVES`."""
        from scipy.special import bdtr

        allowed, drives = 0, 1
        while drives <= MOST_DRIVES:
            while bdtr(allowed, drives, self.bad) > 1.0 - self.confidence:
                drives += 1
            if bdtr(allowed, drives, self.good) >= self.power:
                return FixedPlan(drives, allowed)
            allowed += 1
        shares = f"distinguish a failure fraction of {100.0 * self.good:g} % ('good') from {100.0 * self.bad:g} %"
        raise ConfigError(f"more than {MOST_DRIVES} drives are required to {shares}: give a smaller 'good'")

    def course(self, share: float) -> Course:
        """Return the exact probabilities of the outcomes for a true fraction of failures."""
        longest = OVERRUN * self.fixed_plan().drives
        alive = np.array([1.0])
        passed = failed = expected = 0.0
        for drives in range(1, longest + 1):
            expected += float(alive.sum())
            alive = np.concatenate((alive * (1.0 - share), [0.0])) + np.concatenate(([0.0], alive * share))
            for failures in np.flatnonzero(alive > 0.0):
                state = self.state(int(failures), drives)
                if state is VerdictState.NOT_ENOUGH_DATA:
                    continue
                passed += float(alive[failures]) if state is VerdictState.PASS else 0.0
                failed += float(alive[failures]) if state is VerdictState.FAIL else 0.0
                alive[failures] = 0.0
            if alive.sum() < 1e-9:
                break
            alive = np.where(alive > 1e-15, alive, 0.0)
        return Course(expected, passed, failed)


def sequential_test(terms: Terms) -> SequentialTest:
    """Return the test of terms. If `good` is not given, a fifth of the fraction `bad` is acceptable."""
    bad = 1.0 - terms.prob
    good = bad / 5.0 if terms.good is None else terms.good
    return SequentialTest(good, bad, terms.confidence, CONFIDENCE if terms.power is None else terms.power)


class Course(NamedTuple):
    """The expected course of a sequential test."""

    drives: float  #: Expected number of drives.
    passed: float  #: Probability of a pass.
    failed: float  #: Probability of a fail.
