"""How many drives a campaign needs, and when it may stop: tests of a share of failures with stated error rates.

A share of failures `bad` must not pass with more than the risk `1 - confidence`; a share `good`, which is acceptable,
must not fail with more than the risk `1 - power`. A fixed plan decides after all drives. Wald's sequential probability
ratio test (1945) looks after each drive; its bounds `1 / risk` keep both risks at whatever drive it stops (Ville 1939).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.metrics.config import VerdictState
from sfr_loc_map.metrics.limits import Terms

MOST_DRIVES = 100_000  #: Largest plan that is computed.
OVERRUN = 4  #: Expected numbers follow a sequential test up to so many times the fixed plan.


class FixedPlan(NamedTuple):
    """A number of drives, and how many of them may fail."""

    drives: int
    allowed: int


class SequentialTest(NamedTuple):
    """Shares of failures that are acceptable and not, and the risks of both errors."""

    good: float
    bad: float
    confidence: float  #: A campaign with the share `bad` passes with a risk of at most `1 - confidence`.
    power: float  #: A campaign with the share `good` fails with a risk of at most `1 - power`.

    def ratio(self, failures: float, drives: float) -> float:
        """Return the logarithm of the likelihood of `bad` over that of `good`."""
        passed = (drives - failures) * math.log((1.0 - self.bad) / (1.0 - self.good))
        if not failures:
            return passed
        return passed + failures * (math.log(self.bad / self.good) if self.good > 0.0 else math.inf)

    def state(self, failures: float, drives: float) -> VerdictState:
        """Return the decision after so many drives."""
        ratio = self.ratio(failures, drives)
        if ratio <= math.log(1.0 - self.confidence):
            return VerdictState.PASS
        return VerdictState.FAIL if ratio >= -math.log(1.0 - self.power) else VerdictState.NOT_ENOUGH_DATA

    def decision(self, has_failed: Iterable[bool]) -> tuple[VerdictState, int]:
        """Return the first decision over drives in order, and after how many drives it fell."""
        failures = drives = 0
        for failed in has_failed:
            drives += 1
            failures += failed
            state = self.state(failures, drives)
            if state is not VerdictState.NOT_ENOUGH_DATA:
                return state, drives
        return VerdictState.NOT_ENOUGH_DATA, drives

    def more_without_failure(self, failures: int, drives: int) -> int:
        """Return how many drives without a failure would end it with a pass."""
        step = self.ratio(0, 1)
        missing = (math.log(1.0 - self.confidence) - self.ratio(failures, drives)) / step
        return max(math.ceil(missing - 1e-9), 1)

    def fixed_plan(self) -> FixedPlan:
        """Return the smallest plan that keeps both risks; ConfigError if it is too large to be computed."""
        from scipy.special import bdtr

        allowed, drives = 0, 1
        while drives <= MOST_DRIVES:
            while bdtr(allowed, drives, self.bad) > 1.0 - self.confidence:
                drives += 1
            if bdtr(allowed, drives, self.good) >= self.power:
                return FixedPlan(drives, allowed)
            allowed += 1
        shares = f"{100.0 * self.good:g} % and {100.0 * self.bad:g} %"
        raise ConfigError(f"shares of failures of {shares} need more than {MOST_DRIVES} drives: give a smaller 'good'")

    def course(self, share: float) -> Course:
        """Return how the test ends for a true share of failures, exactly, by the distribution of failures."""
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
    """Return the test of terms; a fifth of the share of failures that must not pass is acceptable unless stated."""
    bad = 1.0 - terms.prob
    return SequentialTest(bad / 5.0 if terms.good is None else terms.good, bad, terms.confidence, terms.power)


class Course(NamedTuple):
    """How a sequential test ends."""

    drives: float  #: Expected number.
    passed: float  #: Probability of a pass.
    failed: float  #: Probability of a fail.
