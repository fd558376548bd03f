"""What follows from all results of a suite: counts, pooled errors, verdicts over all and for each drive, failures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from sfr_loc_map import __version__
from sfr_loc_map.metrics.config import VerdictState
from sfr_loc_map.metrics.limits import COVERAGE_MIN, Limits, parse_limits, verdicts
from sfr_loc_map.metrics.score import Score, Verdict
from sfr_loc_map.metrics.score_json import from_json, to_plain
from sfr_loc_map.suite.groups import Drive, Group, groups_of
from sfr_loc_map.suite.plan import Refusal
from sfr_loc_map.suite.store import Entry, Failure, Store

SCHEMA = "sfr-suite/1"


@dataclass(frozen=True, slots=True, kw_only=True)
class Summary:
    """What follows from all results of a suite.

    Attributes:
        tasks: Tasks of the suite.
        done: Tasks with a result.
        failed: Tasks that failed.
        waiting: Tasks that were not run yet.
        groups: Drives that were run alike.
        drives: Every result.
        failures: Why tasks failed.
        again: Commands that run each of them again, alone.
        refusals: Sources that cannot be read.
        code: Fingerprint of the code.
    """

    tasks: int
    done: int
    failed: int
    waiting: int
    groups: tuple[Group, ...]
    drives: tuple[Drive, ...]
    failures: tuple[Failure, ...]
    again: tuple[str, ...]
    refusals: tuple[Refusal, ...]
    code: str

    @property
    def states(self) -> list[VerdictState]:
        """The verdicts over all groups."""
        return [item.state for group in self.groups for item in group.verdicts]

    @property
    def verdict(self) -> VerdictState | None:
        """The verdict over all, None without limits; a task without result leaves it open."""
        if not self.states:
            return None
        if VerdictState.FAIL in self.states:
            return VerdictState.FAIL
        complete = self.done == self.tasks and not self.refusals
        passed = complete and all(state is VerdictState.PASS for state in self.states)
        return VerdictState.PASS if passed else VerdictState.NOT_ENOUGH_DATA

    def to_dict(self) -> dict[str, object]:
        """Return it as JSON values; of each drive its key, names, verdicts, and where its score stands."""
        return {
            "schema": SCHEMA,
            "version": __version__,
            "code": self.code,
            "counts": {name: getattr(self, name) for name in ("tasks", "done", "failed", "waiting")},
            "verdict": to_plain(self.verdict),
            "groups": to_plain(self.groups),
            "drives": [_drive_plain(drive) for drive in self.drives],
            "failures": [
                {**to_plain(failure), "again": again} for failure, again in zip(self.failures, self.again, strict=True)
            ],
            "refusals": to_plain(self.refusals),
        }


def _drive_plain(drive: Drive) -> dict[str, object]:
    names = ("key", "label", "task", "source", "configuration", "faults", "repeat", "seconds")
    figures = {name: getattr(drive, name) for name in names}
    return figures | {"file": f"results/{drive.key}.json", "verdicts": to_plain(drive.score.verdicts)}


def summarise(store: Store, refusals: Sequence[Refusal] = ()) -> Summary:
    """Return what follows from the results of a suite's folder.

    Args:
        store: The folder.
        refusals: Sources that could not be read.

    Raises:
        InputError: If a result cannot be read.
    """
    entries = store.entries()
    limits = next((parse_limits(entry.task.limits, "limits") for entry in entries if entry.task.limits), None)
    drives = [_drive(entry, store, limits) for entry in entries if entry.state == "done"]
    found = [store.failure(entry.task.key) for entry in entries if entry.state == "failed"]
    failures = tuple(item for item in found if item is not None)
    return Summary(
        tasks=len(entries),
        done=len(drives),
        failed=len(failures),
        waiting=sum(entry.state == "waiting" for entry in entries),
        groups=tuple(groups_of(drives, limits)),
        drives=tuple(drives),
        failures=failures,
        again=tuple(store.command(item.key) for item in failures),
        refusals=tuple(refusals),
        code=entries[0].task.code if entries else "",
    )


def _drive(entry: Entry, store: Store, limits: Limits | None) -> Drive:
    task = entry.task
    score = from_json(store.result_text(task.key), f"'{store.results / task.key}.json'")
    judged = () if limits is None else tuple(item for item in verdicts(limits, score) if _applies(item, score))
    return Drive(
        key=task.key,
        label=task.label,
        task=task.kind.value,
        source=task.source.name,
        configuration=task.configuration,
        faults=task.faults,
        repeat=task.repeat,
        pairing=task.pairing,
        seconds=entry.seconds,
        score=replace(score, verdicts=judged),
    )


def _applies(verdict: Verdict, score: Score) -> bool:
    """Tell whether a limit is on what the task made: a map is not judged by the limits of a drive."""
    if verdict.condition is not None:
        return score.trajectory is not None
    if verdict.metric == COVERAGE_MIN or verdict.metric.startswith("point_error"):
        return score.map is not None
    return verdict.value is not None
