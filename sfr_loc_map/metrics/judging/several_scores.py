"""The common verdict of several scores, the closed requirements, and the limits by which each score is judged."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import NamedTuple

from msgspec.structs import replace as struct_replace

from sfr_loc_map.metrics.config import VerdictState, worst_of
from sfr_loc_map.metrics.figures.records import InputFile, MethodRecord, Provenance
from sfr_loc_map.metrics.judging.judge import judged_by
from sfr_loc_map.metrics.judging.limited import task_of, tasks_of, value_of
from sfr_loc_map.metrics.score.limits import Limit
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.score.verdict import Verdict
from sfr_loc_map.suite_names import Task


class Common(NamedTuple):
    """The common verdict over several scores."""

    state: VerdictState | None  #: None if there is no common verdict.
    text: str = ""  #: Reason for a missing common verdict; empty if the verdict exists or no score was judged.
    difference: str = ""
    """Why the scores do not come from one run, whatever the verdict; empty if they do. If this text is set, no
    requirement is closed."""


SETTINGS_OF = {Task.LOCALISATION: ("trajectory", "localisation"), Task.MAPPING: ("map", "mapping")}
"""Prefixes of the names of the settings of a task and of its score."""

INPUTS_OF_RUN = {
    "truth": "ground truths",
    "map_truth": "ground truths",
    "images": "sets of images",
    "estimate": "estimates",
    "cloud": "clouds",
}
"""Inputs that are equal in all scores of one run, by role, and their words in a message."""


def common_verdict(scores: Sequence[Score]) -> Common:
    """Return the verdict over scores: the worst verdict, which can be a pass only if all scores come from one run.

    Scores come from one run if all have the same item under test, version, configuration, images and ground truth, and
    if a drive and a map come from one recording. Several drives can have a common pass only in a suite, which knows how
    many drives were planned.
    """
    states = [score.verdict for score in scores]
    worst = worst_of(state for state in states if state is not None)
    difference = difference_of_runs(scores) or ""
    is_mixed = None in states and any(states)
    if not is_mixed and not difference:
        return Common(worst)
    if worst is not VerdictState.PASS:
        return Common(worst, difference=difference)
    reason = _reason_without_verdict(scores) if is_mixed else difference
    return Common(None, f"There is no common verdict: {reason}.", difference)


def _reason_without_verdict(scores: Sequence[Score]) -> str:
    """Return why one of several scores has no verdict."""
    if any(score.verdict is None and score.contradiction is not None for score in scores):
        return "an estimate contradicts its ground truth and was not judged"
    return "not every score was judged by limits"


def difference_of_runs(scores: Sequence[Score]) -> str | None:
    """Return why scores do not come from one run of one item under test; None if they do, or for a single score."""
    if len(scores) < 2:
        return None
    items = {_item(score.method) for score in scores}
    configurations = {(part, _configuration(score.method)) for score in scores for part in tasks_of(score)}
    if None in items:
        return "not every score names its item under test"
    if len(items) > 1:
        return f"the scores come from {len(items)} items under test"
    if len(configurations) > len({part for part, _ in configurations}):
        return "the item under test had several configurations"
    return difference_of(scores)


def items_under_test(scores: Sequence[Score]) -> int:
    """Return the largest number, over the tasks, of different items, versions and configurations under test.

    A missing item under test counts as an item.
    """
    found = {(part, _item(score.method), _configuration(score.method)) for score in scores for part in tasks_of(score)}
    parts = [part for part, *_ in found]
    return max(map(parts.count, parts), default=0)


def undeclared_items(undeclared: Sequence[Score], declared: Sequence[Score]) -> tuple[str, ...]:
    """Return the names of the items under test of the first task with an undeclared item; empty without one.

    `declared` are the scores of the configurations of a suite. The other scores must have an item and configuration of
    these, or, without declared scores, one item and configuration. A missing item under test counts as an item.
    """
    for task in Task:
        given, known = (_methods_of(scores, task) for scores in (undeclared, declared))
        if given.keys() - known.keys() and len(given | known) > 1:
            return tuple(sorted(_title(method) for method in (given | known).values()))
    return ()


def _methods_of(scores: Sequence[Score], task: Task) -> dict[object, MethodRecord | None]:
    """Return the methods of a task by item and configuration."""
    methods = [score.method for score in scores if task in tasks_of(score)]
    return {(_item(method), _configuration(method)): method for method in methods}


def _title(method: MethodRecord | None) -> str:
    return "unknown" if method is None else f"{method.name} {method.version or ''}".strip()


def _item(method: MethodRecord | None) -> tuple[str | None, ...] | None:
    return None if method is None else (method.name, method.version, method.sha256)


def _configuration(method: MethodRecord | None) -> str | None:
    """Return the hash of the configuration of a method."""
    return None if method is None else method.config_sha256


def is_closed(verdict: Verdict, score: Score, common: Common, open_ids: Collection[str]) -> bool:
    """Return whether a verdict closes its requirement.

    A pass closes a requirement if no fatal finding fails the score, all scores come from one run, and every verdict on
    the requirement is a pass. `open_ids` are the identifiers of the requirements with other verdicts
    (`open_requirements`).
    """
    is_of_one_run = not common.text and not common.difference
    is_pass = verdict.state is VerdictState.PASS and not score.fatal_findings
    return is_pass and is_of_one_run and verdict.id not in open_ids


def open_requirements(scores: Sequence[Score]) -> frozenset[str]:
    """Return the identifiers of the requirements with a verdict that is not a pass, or with a fatal finding."""
    return frozenset(
        verdict.id
        for score in scores
        for verdict in score.verdicts
        if verdict.id is not None and (verdict.state is not VerdictState.PASS or score.fatal_findings)
    )


def difference_of(scores: Sequence[Score]) -> str | None:
    """Return how scores of one item under test differ; None if they come from one run."""
    made = [score.provenance for score in scores if score.provenance is not None]
    if len(made) < len(scores):
        return "not every score states its inputs and version"
    if len({(item.version, item.commit) for item in made}) > 1:
        return "the scores were made by several versions of sfr_loc_map"
    if (several := several_inputs(made)) is not None:
        return f"the scores come from several {several}, which only a suite judges together"
    if other_recording(made) is not None:
        return "the drive and the map come from different recordings, which only a suite judges together"
    if names := different_settings(scores, made):
        return f"the scores come from several configurations ({', '.join(names)})"
    return None


def several_inputs(made: Sequence[Provenance]) -> str | None:
    """Return the words for the first kind of input that has several contents; None if there is none."""
    for role, words in INPUTS_OF_RUN.items():
        files = [item.inputs[role] for item in made if role in item.inputs]
        if len({file.data_sha256 or file.sha256 for file in files}) > 1:
            return words
    return None


def different_settings(scores: Sequence[Score], made: Sequence[Provenance]) -> list[str]:
    """Return the names of the settings that differ among the scores of a drive, or among those of a map.

    Only the first of these two tasks that has a difference is reported.
    """
    for task, words in SETTINGS_OF.items():
        settings = [
            {name: value for name, value in item.configuration.items() if name.partition(".")[0] in words}
            for score, item in zip(scores, made, strict=True)
            if task in tasks_of(score)
        ]
        names = sorted({name for mine in settings for name in mine})
        if odd := [name for name in names if any(mine.get(name) != settings[0].get(name) for mine in settings)]:
            return odd
    return []


def other_recording(made: Sequence[Provenance]) -> tuple[InputFile, InputFile] | None:
    """Return a ground truth of a drive and one of a map that come from different recordings; None if there are none.

    Inputs with the same hash, or a file and the folder that contains it, come from one recording.
    """
    drives, maps = ([item.inputs[role] for item in made if role in item.inputs] for role in ("truth", "map_truth"))
    different = ((drive, map_truth) for drive in drives for map_truth in maps if not _is_one_place(drive, map_truth))
    return next(different, None)


def _is_one_place(first: InputFile, other: InputFile) -> bool:
    if first.sha256 == other.sha256:
        return True
    if first.resolved is None or other.resolved is None or first.resolved == other.resolved:
        return False  # the path is unknown, or its content has changed
    paths = Path(first.resolved), Path(other.resolved)
    return paths[0].is_relative_to(paths[1]) or paths[1].is_relative_to(paths[0])


def each_by_its_limits(scores: Sequence[Score]) -> list[Score]:
    """Return scores that were judged by one limits file, each judged by the limits that apply to it.

    For example, a limit on a map is omitted from the score of a drive on two conditions: the score of a map is judged
    by the same limit, and the score of the drive has no value for the limit. If there are only drives, the limit
    applies to every score. A caveat of the score names omitted limits.
    """
    of_own_task = [
        limit for score in scores for limit in score.active_rules.limits if task_of(limit) in tasks_of(score)
    ]
    return [_by_its_limits(score, of_own_task) for score in scores]


def _by_its_limits(score: Score, of_own_task: Collection[Limit]) -> Score:
    """Return a score without the limits of another task that are in `of_own_task` and have no value in this score."""
    rules = score.active_rules
    own = tasks_of(score)
    kept = tuple(
        item
        for item in rules.limits
        if task_of(item) in own or item not in of_own_task or value_of(item, score).value is not None
    )
    if len(kept) == len(rules.limits):
        return score
    names = ", ".join(item.shown_name for item in rules.limits if item not in kept)
    judged = judged_by(score, struct_replace(rules, limits=kept) if kept else None, partial=rules.partial)
    return judged.with_caveat(f"the limits {names} are judged in another of the scores")
