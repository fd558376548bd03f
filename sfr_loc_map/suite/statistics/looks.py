"""The looks at the results of a suite before the present one, and the deviations that follow from them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from sfr_loc_map.metrics.config import VerdictState
from sfr_loc_map.metrics.judging.limits_file import parse_limits
from sfr_loc_map.metrics.judging.proof import SEQUENTIAL
from sfr_loc_map.metrics.score.limits import BOUND, Population
from sfr_loc_map.metrics.score.verdict import ProofRecord
from sfr_loc_map.metrics.statistics.tolerance import BoundMethod
from sfr_loc_map.report.verdict_view import limited_name
from sfr_loc_map.suite.jobs.digests import digest
from sfr_loc_map.suite.jobs.job_outcome import JobState
from sfr_loc_map.suite.planning.looks import Look, LookGroup, LookVerdict, looks_of_group
from sfr_loc_map.suite.planning.plan import Plan
from sfr_loc_map.suite.statistics.common_deviations import CommonDeviation
from sfr_loc_map.suite.statistics.groups import Group, by_group, groups_of
from sfr_loc_map.suite.statistics.scored_job import ResultReader, ScoredJob
from sfr_loc_map.suite.store import Store


def looks_before(plan: Plan, store: Store) -> tuple[Look, ...]:
    """Return the looks before a plan is saved: those of the plan in the folder, and a look by that plan itself.

    If the plan in the folder has the same drives and limits, its look is not another one.
    """
    earlier = store.earlier_plan
    if earlier is None:
        return ()
    if earlier.extensions == plan.extensions and earlier.stated_limits == plan.stated_limits:
        return earlier.looks
    limits = parse_limits(earlier.stated_limits, f"'{store.plan_file}': limits") if earlier.stated_limits else None
    results = ResultReader(store, limits).results_of(earlier.jobs)
    if limits is None or not results:
        return earlier.looks
    unfinished = [job for job in earlier.jobs if store.state(job) is not JobState.DONE]
    in_groups = by_group(results)
    groups = tuple(
        LookGroup(
            key=group.key,
            measurements=_measurements_of(in_groups[group.key]),
            verdicts=tuple(
                LookVerdict(name=item.name, condition=item.condition, state=item.state, n=item.n)
                for item in group.verdicts
            ),
        )
        for group in groups_of(results, limits, unfinished)
    )
    return (*earlier.looks, Look(limits=digest(earlier.stated_limits), groups=groups))


def _measurements_of(results: Sequence[ScoredJob]) -> tuple[str, ...]:
    return tuple(result.job.measurement for result in results)


def deviations_of_looks(plan: Plan, groups: Sequence[Group], results: Sequence[ScoredJob]) -> Iterator[CommonDeviation]:
    """Yield the deviations of a report whose results were judged before: with fewer drives, or by other limits."""
    if not plan.stated_limits:
        return
    present = digest(plan.stated_limits)
    in_groups = by_group(results)
    have_limits_changed = False
    for group in groups:
        looks = looks_of_group(plan.looks, group.key, _measurements_of(in_groups[group.key]))
        have_limits_changed |= bool(looks) and looks[0][0].limits != present
        for text in _looks_with_fewer_drives(group, [of_look for _, of_look in looks]):
            yield CommonDeviation(text=text, results=group.results, of=group.key.text)
    if have_limits_changed:
        text = "The limits differ from those by which the same results were judged first in this folder."
        yield CommonDeviation(text=text, results=len(results), of="all results")


def _could_be_met(drives: int, proof: ProofRecord) -> bool:
    """Return whether a number of drives without a larger error would have proved the limit.

    With fewer drives, a bound by order statistics has no value: the look could not have passed.
    """
    return proof.method != BoundMethod.ORDER or proof.prob**drives <= 1.0 - proof.confidence


def _looks_with_fewer_drives(group: Group, looks: Sequence[LookGroup]) -> Iterator[str]:
    """Yield a deviation for each tolerance bound whose number of drives was increased after it was not met."""
    for item in group.verdicts:
        proof = item.proof
        if proof is None or proof.method == SEQUENTIAL or proof.interpretation == Population.TEMPORAL:
            continue
        numbers = [
            verdict.n or 0
            for look in looks
            for verdict in look.verdicts
            if (verdict.name, verdict.condition) == (item.name, item.condition)
            and verdict.state in (VerdictState.FAIL, VerdictState.NOT_ENOUGH_DATA)
            and (verdict.n or 0) < (item.n or 0)
            and _could_be_met(verdict.n or 0, proof)
        ]
        if numbers:
            name = limited_name(item.figure or "", None, item.condition, BOUND)
            yield (
                f"The confidence of {name} holds for a number of drives that is fixed in advance, but drives were "
                f"added until there were {item.n}, after the limit had not been met with "
                f"{', '.join(str(number) for number in numbers)} drives. The probability of a wrong pass is larger."
            )
