"""Requirements with a fraction, a confidence and an interpretation (ECSS-E-ST-60-10C).

A limit such as `position_bound_m: {limit: 0.1, prob: 0.95, confidence: 0.95, interpretation: mixed}` is judged by a
tolerance bound (`metrics.statistics.tolerance`) of independent errors. The interpretation defines these errors
[ECSS-E-ST-60-10C, 4.1.4.2]:

- temporal: the fraction `prob` of the sub-trajectories of every drive meets the limit. Each drive is judged separately.
- ensemble: the fraction `prob` of all drives meets the limit throughout. A drive is represented by its largest error.
- mixed: the fraction `prob` of the sub-trajectories of all drives meets the limit. A drive is represented by one of its
  sub-trajectories.

If the limit also has an acceptable fraction of failures (`good`), the drives are judged by a sequential test instead of
a tolerance bound, so that a campaign of drives may stop as soon as the test decides.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Mapping, Sequence
from decimal import Decimal
from typing import NamedTuple

import numpy as np
from msgspec.structs import asdict, replace

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.metrics.config import VerdictState
from sfr_loc_map.metrics.figures.rows import Figure, figure_row
from sfr_loc_map.metrics.score.limits import Population, Terms
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.score.verdict import ProofRecord
from sfr_loc_map.metrics.statistics.tolerance import CONFIDENCE, BoundMethod, Sample, count_needed, tolerance_bound

SEQUENTIAL = "sequential"  #: Method of a verdict by a sequential test.
SEED = 20240302  #: Seed of the choice of the sub-trajectory that represents a drive.


class Proof(NamedTuple):
    """The result of the proof of a requirement."""

    state: VerdictState
    bound: float | None
    record: ProofRecord
    n: int  #: Number of errors: sub-trajectories of the deciding drive, or drives.


def sample_of(score: Score, figure: str, condition: str | None) -> Sample | None:
    """Return all errors of a figure over a condition; None if the score lacks some of the errors."""
    row = score.judged_row(figure, condition=condition)
    errors = score.all_errors(figure, condition)
    if errors is None or row is None or row.independent is None or not np.isfinite(errors).all():
        return None
    return Sample(errors, min(row.independent, float(len(errors))))


def prove(terms: Terms, limit: float, drives: Mapping[str, Sequence[Sample]], truth_error: float = 0.0) -> Proof:
    """Return the result of the proof that the errors of drives meet a limit.

    `drives` contains the runs of each drive by name, in the order of a sequential test. `truth_error` is the change of
    an error that the error of the truth can cause.
    """
    runs = {name: [sample for sample in samples if len(sample.errors)] for name, samples in drives.items()}
    runs = {name: samples for name, samples in runs.items() if samples}
    if not all(np.isfinite(sample.errors).all() for samples in runs.values() for sample in samples):
        return prove_sample(terms, limit, Sample(np.empty(0), 0.0))  # an unknown error permits no decision
    if terms.interpretation is Population.TEMPORAL:
        proofs = [prove_sample(terms, limit, sample, truth_error) for samples in runs.values() for sample in samples]
        if not proofs:
            return prove_sample(terms, limit, Sample(np.empty(0), 0.0))
        return min(proofs, key=lambda proof: (proof.state.rank, -(proof.bound or 0.0)))
    sample = sample_over_drives(terms.interpretation, runs)
    if terms.good is None:
        return prove_sample(terms, limit, sample, truth_error)
    return prove_sequentially(terms, limit, sample, truth_error)


# ---- the errors that represent drives


def sample_over_drives(interpretation: Population, drives: Mapping[str, Sequence[Sample]]) -> Sample:
    """Return the errors that represent the drives, in the order of the drives."""
    chosen = [error_of_drive(interpretation, name, samples) for name, samples in drives.items()]
    return Sample(np.array(chosen), float(len(chosen)))


def error_of_drive(interpretation: Population, name: str, samples: Sequence[Sample]) -> FloatArray:
    """Return the error that represents a drive: the largest size, or the error of one sub-trajectory.

    The sub-trajectory is drawn at random, with the name of the drive as the seed.
    """
    errors = np.concatenate([sample.vectors for sample in samples])
    if interpretation is Population.ENSEMBLE:
        return np.asarray([np.max(np.linalg.norm(errors, axis=1))])
    generator = np.random.default_rng([SEED, *hashlib.sha256(name.encode()).digest()])
    return np.asarray(errors[generator.integers(len(errors))])


# ---- a tolerance bound of a sample


def prove_sample(terms: Terms, limit: float, sample: Sample, truth_error: float = 0.0) -> Proof:
    """Return the result of the proof, from a sample, that the fraction `prob` of the errors is within a limit.

    The error of the truth must not change the decision: a pass requires the upper bound to be at most
    `limit - truth_error`, and a fail requires the lower bound to exceed `limit + truth_error`.
    """
    prob = terms.prob
    confidence = terms.confidence
    bound = tolerance_bound(sample, prob, confidence, is_normal=terms.normal)
    state = VerdictState.NOT_ENOUGH_DATA
    if bound.upper is not None and bound.upper <= limit - truth_error:
        state = VerdictState.PASS
    elif bound.lower is not None and bound.lower > limit + truth_error:
        state = VerdictState.FAIL
    more = None
    if state is VerdictState.NOT_ENOUGH_DATA:
        needed = count_needed(sample, limit - truth_error, prob, confidence, is_normal=terms.normal)
        given = sample.series_count if bound.method is BoundMethod.ORDER else int(sample.independent)
        more = None if needed is None else max(needed - given, 1)
    return Proof(state, bound.upper, record_of(terms, bound.method.value, sample.independent, more), len(sample.errors))


# ---- a sequential test of drives


class SequentialTest(NamedTuple):
    """Wald's sequential probability ratio test (1945) of a fraction of failures, which is evaluated after each drive.

    The fraction `good` is acceptable, and the fraction `bad` is not. The bounds `1 / risk` of the likelihood ratio keep
    both risks for any stopping time (Ville 1939).
    """

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

        A test that passes at an early drive is also evaluated over all drives, and fails if these together lead to a
        fail. The risks of the test hold at any time, and later drives that miss the limit must not be ignored.
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


def prove_sequentially(terms: Terms, limit: float, sample: Sample, truth_error: float = 0.0) -> Proof:
    """Return the decision of the sequential test over the drives in order; the bound is their largest error.

    The error of the truth must not change the decision. Drives whose error is within `truth_error` of the limit
    therefore count as met in one test and as failed in another, and both tests must have the same decision.
    """
    test = sequential_test(terms)
    has_failed = (sample.sizes > limit).tolist()
    state, drives = test.decision_over_all(has_failed)
    if truth_error > 0.0:
        ends = [
            test.decision_over_all((sample.sizes > limit + shift).tolist()) for shift in (-truth_error, truth_error)
        ]
        drives = max(after for _, after in ends)
        state = ends[0][0] if ends[0][0] is ends[1][0] else VerdictState.NOT_ENOUGH_DATA
    undecided = state is VerdictState.NOT_ENOUGH_DATA
    more = test.more_without_failure(sum(has_failed), len(has_failed)) if undecided else None
    largest = float(sample.sizes[:drives].max()) if drives else None
    return Proof(state, largest, record_of(terms, SEQUENTIAL, float(drives), more), drives)


# ---- the record, the row and the text of a proof


def record_of(terms: Terms, method: str, independent: float, more: int | None) -> ProofRecord:
    """Return the record of the terms and of the result of a proof."""
    used = replace(terms, power=None if terms.good is None else sequential_test(terms).power)
    return ProofRecord(**asdict(used), method=method, independent=independent, more=more)


def bound_row(figure: str, unit: str, condition: str | None, proof: Proof) -> Figure:
    """Return the row of a tolerance bound. Its part states all terms, so that bounds by other terms are other rows."""
    record = proof.record
    share, confidence = percent(record.prob), percent(record.confidence)
    part = f"{share} of {figure} errors with {confidence} confidence, {record.interpretation}"
    if record.normal:
        part += ", declared normal"
    if record.good is not None:
        part += f", good {percent(record.good)} with {percent(record.power or 0.0)} power"
    row = figure_row("bound", condition, part, value=proof.bound, independent=record.independent)
    return replace(row, unit=unit)


def percent(fraction: float) -> str:
    """Return a fraction in per cent with all its decimals, so that different fractions have different texts."""
    return f"{(Decimal(repr(float(fraction))) * 100).normalize():f} %"


def words_of(record: ProofRecord, state: VerdictState, count: int | None) -> str:
    """Return the terms and the method of a proof as text; without a decision also how many more errors are required.

    `count` is the number of errors, of which `record.independent` are independent; None if it is unknown.
    """
    share = f"{percent(record.prob)} with {percent(record.confidence)} confidence"
    share += f", {record.interpretation}, {record.method}"
    if state is not VerdictState.NOT_ENOUGH_DATA:
        return share
    is_of_drives = record.interpretation != Population.TEMPORAL
    what = "drives" if is_of_drives else "independent sub-trajectories"
    if record.more is None:
        return f"{share}; more {what} like these cannot decide: give a larger limit or a smaller prob"
    required = f"{share}; required: {record.more} more {what}"
    if is_of_drives or not count or not 0.0 < record.independent < count:
        return required
    return f"{required} (about {math.ceil(record.more * count / record.independent)} at the present overlap)"
