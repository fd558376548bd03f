"""The score of a run in progress, made of the same results as the score of a finished run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from sfr_loc_map.geometry.arrays import IntArray
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.message_text import counted
from sfr_loc_map.metrics.calls.calls import concatenated
from sfr_loc_map.metrics.completeness.expected_items import due_stamps, live_completeness
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.metrics.figures.records import Provenance
from sfr_loc_map.metrics.figures.results import CallsResult, MapResult
from sfr_loc_map.metrics.score.limits import Limits
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.scoring.assembly import score_of_results
from sfr_loc_map.scoring.conversion import ConventionFinding
from sfr_loc_map.scoring.inputs import Run
from sfr_loc_map.scoring.results import calls_result, expected_calls, result_without_cloud, trajectory_result
from sfr_loc_map.suite_names import Task

MAX_LISTED = 5  #: Maximum number of discarded intervals that are kept and listed, the latest ones.


class DiscardedInterval(NamedTuple):
    """Received data that a live score has discarded."""

    first_ns: int  #: Earliest stamp of the discarded data.
    last_ns: int  #: Latest stamp of the discarded data.
    cause: str  #: Event that discarded the data.


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LiveRun:
    """State of a run in progress that its node knows in addition to the received data."""

    in_flight_s: float = 0.0  #: Results of the last `in_flight_s` seconds may still arrive; 0 after the run.
    details: bool = True  #: Whether the data of plots is kept, in addition to the errors of sub-trajectories.
    dropped: int = 0  #: Number of messages that were lost in transport or dropped.
    restarts: int = 0  #: Number of restarts caused by a jump of the stamps.
    discards: int = 0  #: Number of intervals whose data the node received and then discarded.
    discarded: tuple[DiscardedInterval, ...] = ()  #: The latest of these intervals, at most `MAX_LISTED`.
    #: Number of estimates that were published before the first that the node received, as after a restart of the node.
    missed_estimates: int = 0
    #: Number of changes of the publisher, by scored topic, during the run; two publishers of a topic count as a change.
    publisher_changes: Mapping[str, int] = field(default_factory=dict)
    #: Whether a process that published the estimates also published the ground truth.
    is_truth_of_item: bool = False
    repeated_truth: int = 0  #: Number of true poses that were dropped because another one has their stamp.
    provenance: Provenance | None = None  #: Provenance of the score.

    @property
    def is_under_way(self) -> bool:
        """Whether results may still arrive."""
        return self.in_flight_s > 0.0

    @property
    def in_flight_ns(self) -> int:
        """`in_flight_s` in nanoseconds."""
        return round(self.in_flight_s * NS_PER_S)


ENDED = LiveRun()  #: A run that has ended without losses, of which all data of plots are kept.


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LiveData:
    """The received data of a run in progress, with the results that are not computed again for each score."""

    run: Run
    messages: int  #: Number of received poses, true poses and calls.
    map: MapResult | None  #: Result of the worst map; None before the first map.
    convention_finding: ConventionFinding | None  #: Result of the last diagnosis.


def score_so_far(received: LiveData, live: LiveRun, config: ScoreConfig, limits: Limits | None = None) -> Score:
    """Return the score of a run in progress. `config` has the conditions of `limits` (`judgement.with_conditions`)."""
    run = received.run
    trajectory = trajectory_result(
        run,
        config.trajectory,
        received.convention_finding,
        frozenset() if limits is None else limits.bounded_figures,
        details=live.details,
        is_live=True,
        in_flight_ns=live.in_flight_ns,
    )
    surface = received.map or result_without_cloud(run.expected.unmapped, None)
    if not live.details:
        surface = replace(surface, details=None)
    calls = calls_result(run, _due_calls(run, live.in_flight_ns), details=live.details)
    calls = _with_transport(calls, live, received.messages)
    return score_of_results(run, trajectory, surface, calls, live.provenance, config, limits)


def _due_calls(run: Run, in_flight_ns: int) -> Mapping[Task, IntArray | None]:
    """Return the stamps of the pairs whose calls are due; calls of the last pairs may still arrive."""
    expected = expected_calls(run)
    if not run.stats:
        return expected
    calls = concatenated([item.calls for item in run.stats])
    is_localisation = calls.is_localisation
    of_task = {Task.LOCALISATION: calls.stamps_ns[is_localisation], Task.MAPPING: calls.stamps_ns[~is_localisation]}
    return {
        task: None if stamps is None else due_stamps(stamps, of_task[task], in_flight_ns)
        for task, stamps in expected.items()
    }


def _with_transport(calls: CallsResult, live: LiveRun, messages: int) -> CallsResult:
    """Return the result of the calls with the counts and caveats of a live run. Without messages, there are no rows."""
    if live.discards:
        calls = replace(calls, caveats=(*calls.caveats, _discarded_text(live)))
    if live.missed_estimates:
        text = (
            f"{counted(live.missed_estimates, 'estimate')} published before the monitor received the first one: the "
            "live score does not contain them"
        )
        calls = replace(calls, caveats=(*calls.caveats, text))
    calls = replace(calls, caveats=(*calls.caveats, *_publisher_caveats(live)))
    if live.repeated_truth:
        text = (
            f"true poses with the stamp of another one are ignored (number: {live.repeated_truth}): stamp each true "
            "pose with the time of its measurement"
        )
        calls = replace(calls, caveats=(*calls.caveats, text))
    if not messages and not live.dropped and not live.restarts and not live.publisher_changes:
        return calls
    changes = sum(live.publisher_changes.values())
    rows = live_completeness(messages, live.dropped, live.restarts, changes)
    return replace(calls, figures=(*calls.figures, *rows))


def _publisher_caveats(live: LiveRun) -> Iterator[str]:
    """Yield the caveats about the publishers of the scored topics."""
    for topic, count in sorted(live.publisher_changes.items()):
        yield (
            f"{topic} had more than one publisher in the run (changes: {count}): its process or its publisher was "
            "started again, for example after a crash, or several processes publish the topic; stop all but one, and "
            "repeat the run"
        )
    if live.is_truth_of_item:
        yield (
            "a process that published the estimates also published the ground truth, as a player of a bag or a bridge "
            "also does: verify that the item under test does not receive the ground truth"
        )


def _discarded_text(live: LiveRun) -> str:
    """Return the caveat about discarded data, with the latest intervals."""
    listed = [f"{item.first_ns} to {item.last_ns} ns ({item.cause})" for item in live.discarded]
    return (
        f"the live score does not contain data that was received and then discarded; number of discarded intervals: "
        f"{live.discards}, the latest: {', '.join(listed)}"
    )
