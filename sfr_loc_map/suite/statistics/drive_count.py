"""`sfr suite plan`: how many drives a requirement needs, from its terms and, of a suite, from the spread seen."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.metrics.config import VerdictState
from sfr_loc_map.metrics.judging.proof import sample_over_drives
from sfr_loc_map.metrics.judging.sequential import sequential_test
from sfr_loc_map.metrics.limits import BOUND, Interpretation, Limits, Terms
from sfr_loc_map.metrics.tolerance import count_needed, moments, normal_count, zero_failure_count
from sfr_loc_map.report.verdict_view import limited_name
from sfr_loc_map.suite.statistics.summary import ScoredJob, samples_by_drive


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveCount:
    """How many drives prove one requirement; None is unknown, or no number."""

    runs: str  #: Runs of the suite, empty without one.
    limit: str  #: Name of the limit, empty without one.
    prob: float
    confidence: float
    power: float
    good: float  #: Share of failures that is acceptable.
    without_failure: int  #: Drives without a failure.
    fixed: int  #: Drives of the fixed plan with the stated power.
    allowed: int  #: Failures that the fixed plan allows.
    sequential: float  #: Expected drives of the sequential test at the share `good`.
    sequential_at_none: float  #: The same where no drive fails.
    drives: int | None = None  #: Drives that there are.
    failures: int | None = None  #: Drives beyond the limit.
    at_the_rate_seen: int | None = None  #: Drives if they fail as often as those seen.
    if_normal: int | None = None  #: Drives if errors are declared to be normal, with the spread seen.
    state: VerdictState | None = None  #: Decision of the sequential test.


def count_without_runs(terms: Terms) -> DriveCount:
    """Return how many drives terms need."""
    test = sequential_test(terms)
    plan = test.fixed_plan()
    return DriveCount(
        runs="",
        limit="",
        prob=terms.prob,
        confidence=terms.confidence,
        power=terms.power,
        good=test.good,
        without_failure=zero_failure_count(terms.prob, terms.confidence),
        fixed=plan.drives,
        allowed=plan.allowed,
        sequential=test.course(test.good).drives,
        sequential_at_none=test.course(0.0).drives,
    )


def drive_counts(drives: Sequence[ScoredJob], limits: Limits | None) -> Iterator[DriveCount]:
    """Yield how many drives each limit with a share needs, over equal runs; ConfigError without such a limit."""
    chosen = [] if limits is None else [item for item in limits.limits if item.terms is not None]
    if not chosen:
        raise ConfigError("the suite has no limit with a share, such as position_bound_m: {limit: 0.1, prob: 0.95}")
    members: dict[tuple[str, str, str], list[ScoredJob]] = {}
    for drive in drives:
        members.setdefault(drive.group_key, []).append(drive)
    for key, jobs in members.items():
        for limit in chosen:
            terms = limit.terms or Terms()
            samples = samples_by_drive(limit, [(job.job.drive, job.score) for job in jobs])
            if not samples:
                continue
            interpretation = terms.interpretation
            if interpretation is Interpretation.TEMPORAL:  # a drive is no sample of itself
                interpretation = Interpretation.ENSEMBLE
            sample = sample_over_drives(interpretation, samples)
            known = moments(sample)
            has_failed = sample.sizes > limit.limit
            plan = count_without_runs(terms)
            yield DriveCount(
                **{name: getattr(plan, name) for name in DriveCount.__slots__ if name not in OF_RUNS},
                runs=", ".join(part for part in key if part),
                limit=f"{limited_name(limit.limited.figure, None, limit.condition, BOUND)}, {interpretation}",
                drives=len(sample.errors),
                failures=int(has_failed.sum()),
                at_the_rate_seen=count_needed(sample, limit.limit, terms.prob, terms.confidence),
                if_normal=None if known is None else normal_count(known, limit.limit, terms.prob, terms.confidence),
                state=sequential_test(terms).decision(has_failed.tolist())[0],
            )


OF_RUNS = ("runs", "limit", "drives", "failures", "at_the_rate_seen", "if_normal", "state")
"""Fields that depend on runs."""
