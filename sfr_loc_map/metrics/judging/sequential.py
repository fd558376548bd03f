"""Sequential test of a fraction of failures with given error rates, which states when a campaign of drives may stop.

A method whose fraction of failures is `bad` passes with a probability of at most `1 - confidence`. A method whose
fraction is `good`, which is acceptable, fails with a probability of at most `1 - power`. Wald's sequential probability
ratio test (1945) is evaluated after each drive. The bounds `1 / risk` of the test keep both risks for any stopping time
(Ville 1939).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from sfr_loc_map.metrics.config import VerdictState
from sfr_loc_map.metrics.score.limits import Terms
from sfr_loc_map.metrics.statistics.tolerance import CONFIDENCE


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

    def decision_over_all(self, has_failed: Sequence[bool]) -> tuple[VerdictState, int]:
        """Return the decision over drives in order, and the number of drives that it is based on.

        A test that passes at an early drive fails if all drives together fail: the risks of the test hold at any time,
        and drives that miss the limit must not be hidden behind others.
        """
        state, drives = self.decision(has_failed)
        if state is VerdictState.PASS and self.state(sum(has_failed), len(has_failed)) is VerdictState.FAIL:
            return VerdictState.FAIL, len(has_failed)
        return state, drives

    def more_without_failure(self, failures: int, drives: int) -> int | None:
        """Return the number of additional drives without a failure that lead to a pass; None if no number suffices."""
        if failures and not self.good:
            return None
        step = self.ratio(0, 1)
        missing = (math.log(1.0 - self.confidence) - self.ratio(failures, drives)) / step
        return max(math.ceil(missing - 1e-9), 1)


def sequential_test(terms: Terms) -> SequentialTest:
    """Return the test of terms. If `good` is not given, a fifth of the fraction `bad` is acceptable."""
    bad = 1.0 - terms.prob
    good = bad / 5.0 if terms.good is None else terms.good
    return SequentialTest(good, bad, terms.confidence, CONFIDENCE if terms.power is None else terms.power)
