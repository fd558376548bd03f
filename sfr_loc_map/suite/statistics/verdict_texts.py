"""The outcome of a suite: what failed, what is incomplete and what is undecided, as texts for a command."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from sfr_loc_map.message_text import counted
from sfr_loc_map.metrics.config import VerdictState
from sfr_loc_map.metrics.judging.reasons import why_open
from sfr_loc_map.metrics.score.verdict import counts_of
from sfr_loc_map.suite.statistics.group_verdicts import GroupVerdict
from sfr_loc_map.suite.statistics.groups import Group
from sfr_loc_map.suite.statistics.summary import Summary

UNDECIDED = (VerdictState.NOT_ENOUGH_DATA, VerdictState.NOT_JUDGED)


@dataclass(frozen=True, slots=True)
class VerdictTexts:
    """What prevents a suite from passing, one text each, and a warning about conditions (`without_drives`).

    Failures take precedence over jobs without a result, and these over missing judgements.
    """

    failures: tuple[str, ...]  #: Failures of methods, and missed limits.
    without_result: tuple[str, ...]  #: Failed jobs and refused sources.
    waiting: tuple[str, ...]  #: Jobs that have no result yet but are needed for a verdict.
    incomplete: tuple[str, ...]  #: Groups that lack results.
    undecided: tuple[str, ...]  #: Limits that could not be judged.
    without_drives: tuple[str, ...]  #: Conditions under which no drive has a figure. They alone do not prevent a pass.


def verdict_texts_of(summary: Summary) -> VerdictTexts:
    """Return the outcome of a suite."""
    verdicts = [(group, item) for group in summary.groups for item in group.verdicts]
    counts = summary.counts
    is_waiting = counts.waiting > 0 and summary.is_judged and not summary.is_decided
    return VerdictTexts(
        failures=tuple(_failures(summary)),
        without_result=tuple(_without_result(summary)),
        without_drives=tuple(_without_drives(summary)),
        waiting=(f"{counts.waiting} of {counts.jobs} jobs have no result yet",) if is_waiting else (),
        incomplete=tuple(
            _incomplete_text(summary, *pair) for pair in verdicts if pair[1].state is VerdictState.INCOMPLETE
        ),
        undecided=tuple(_undecided_text(summary, *pair) for pair in verdicts if pair[1].state in UNDECIDED),
    )


def _failures(summary: Summary) -> Iterator[str]:
    """Yield the texts about failed methods and about missed limits, each if there are any."""
    items = [item for group in summary.groups for item in group.verdicts]
    methods = [item.name for item in items if item.state is VerdictState.FAIL and item.figure is None]
    if methods:
        yield f"methods failed: {', '.join(methods)}"
    limits = counts_of(summary.on_limits)
    if limits.missed:
        yield f"{limits.missed} of {limits.limits} limits over all drives missed"


def _without_result(summary: Summary) -> Iterator[str]:
    """Yield the number of failed jobs and the number of refused sources, each if there are any."""
    if summary.failures:
        yield f"{counted(len(summary.failures), 'job')} failed"
    if summary.refusals:
        yield f"{counted(len(summary.refusals), 'source')} refused"


def _without_drives(summary: Summary) -> Iterator[str]:
    """Yield a sentence for each condition under which the results have no sub-trajectory."""
    counts: dict[str, int] = {}
    for group in summary.groups:
        for row in group.figures:
            if row.condition is not None:
                counts[row.condition] = counts.get(row.condition, 0) + (row.n or 0)
    for condition, count in counts.items():
        if count == 0:
            yield f"no drive has a sub-trajectory for the condition {condition}: give a condition that the drives have"


def _incomplete_text(summary: Summary, group: Group, item: GroupVerdict) -> str:
    """Return which drives are incomplete, and the reason for the first of them."""
    if item.figure is not None:
        return f"{item.name} of {group.key.text}: incomplete, because drives lack values of the figure"
    text = f"incomplete: {counted(item.missed_by, 'drive')} of {group.key.text}"
    if item.value is not None and item.value < 1.0:
        text += f"; the worst drive covers {100.0 * item.value:.4g} %"
    reasons = (
        f"; {result.job.label}: {result.score.incomplete}"
        for result in summary.results
        if result.job.group == group.key and result.score.incomplete is not None
    )
    return text + next(reasons, "")


def _undecided_text(summary: Summary, group: Group, item: GroupVerdict) -> str:
    is_open = item.state is VerdictState.NOT_ENOUGH_DATA
    reason = why_open(item, summary.score_of(group)) if is_open else item.state.value
    return f"{item.name} of {group.key.text}: {reason}"
