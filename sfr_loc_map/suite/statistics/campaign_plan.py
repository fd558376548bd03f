"""The number of drives of a campaign whose test has given error rates (`judging.sequential`).

A fixed plan decides after all drives, and the course of the sequential test is its expected number of drives.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.metrics.config import VerdictState
from sfr_loc_map.metrics.judging.sequential import SequentialTest

MOST_DRIVES = 100_000  #: Maximum number of drives of a plan.
OVERRUN = 4  #: Multiple of the fixed plan up to which the expected number of drives is computed.


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
    """Return the smallest plan that keeps both risks; ConfigError if it exceeds `MOST_DRIVES`."""
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
