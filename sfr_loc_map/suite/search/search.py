"""A search from its first point to its result; the jobs of each point are results in the folder of a suite."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any, NamedTuple

import yaml

from sfr_loc_map import __version__
from sfr_loc_map.errors import InputError
from sfr_loc_map.message_text import one_line
from sfr_loc_map.metrics.config import CallKind
from sfr_loc_map.metrics.figures.subjects import LimitSection
from sfr_loc_map.metrics.score.limits import LIMITED_NUMBERS, LimitedNumber, fault_of_bound
from sfr_loc_map.metrics.stored.score_json import to_plain
from sfr_loc_map.suite.jobs.job import Job
from sfr_loc_map.suite.jobs.job_outcome import FailureCause, JobState
from sfr_loc_map.suite.planning.plan import Plan
from sfr_loc_map.suite.search.record import LeftOutRecord, PointRecord, SearchRecord, badness_of, ratio_text
from sfr_loc_map.suite.search.specification import WITHOUT_EFFECT, Point, SearchSettings, SearchSpecification
from sfr_loc_map.suite.search.worst_case import (
    RandomChooser,
    TreeChooser,
    TriedPoint,
    coverage_of,
    lost_ratio_of,
    reduced,
    slices_of,
    tried_points,
)
from sfr_loc_map.suite.store import Store

_log = logging.getLogger(__name__)

CASE = "case.yaml"
RunWaitingJobs = Callable[[Sequence[Job]], None]
"""Runs jobs and stores their results in the folder of the suite."""


class FoundCase(NamedTuple):
    """A finished search, and the suite that repeats its reduced case."""

    record: SearchRecord
    case_file: str  #: Text of the file of the suite.


def find_worst_case(
    specification: SearchSpecification, store: Store, run_waiting_jobs: RunWaitingJobs, *, at_random: bool = False
) -> FoundCase:
    """Search for the worst point, reduce the point to a case, and compute slices through the case.

    Points that have results are not run again.
    """
    points = _Points(specification, store, run_waiting_jobs)
    try:
        return _search(specification, points, at_random=at_random)
    finally:  # also after an interruption, the folder has the plan of its results
        store.save_plan(Plan.of_search(specification.path, points.planned.values()))


class _Points:
    """Runs the points of a search, and records their jobs and the points that cannot be run."""

    def __init__(self, specification: SearchSpecification, store: Store, run_waiting_jobs: RunWaitingJobs) -> None:
        self.planned: dict[str, Job] = {}
        self.left_out: dict[Point, str] = {}
        self._specification, self._store, self._run_waiting_jobs = specification, store, run_waiting_jobs

    def evaluate(self, points: Sequence[Point]) -> list[TriedPoint]:
        """Run points, and return them with their results. The ratio of a point is that of its worst seed."""
        jobs = {point: self._specification.jobs_at(point) for point in points}
        by_key = {job.key: job for of_point in jobs.values() for job in of_point}
        self.planned |= by_key
        waiting = [job for job in by_key.values() if _is_open(self._store, job)]
        if waiting:
            self._run_waiting_jobs(waiting)
        _check_host(self._store, [job for of_point in jobs.values() for job in of_point])
        return [self._tried(point, jobs[point]) for point in points]

    def _tried(self, point: Point, jobs: Sequence[Job]) -> TriedPoint:
        if refused := [job for job in jobs if self._store.state(job) is JobState.FAILED]:
            self.left_out[point] = one_line(self._store.failure(refused[0]).message)
            return TriedPoint(point, refusal=self.left_out[point])
        return TriedPoint(point, max(map(self._ratio_of, jobs), key=badness_of))

    def _ratio_of(self, job: Job) -> float | None:
        return self._specification.ratio_of(self._store.score(job))

    def worst_seed(self, point: Point) -> int:
        """Return the seed with the largest ratio at a point that was run."""
        jobs = self._specification.jobs_at(point)
        return max(jobs, key=lambda job: badness_of(self._ratio_of(job))).seed


def _search(specification: SearchSpecification, points: _Points, *, at_random: bool) -> FoundCase:
    chosen = specification.settings
    parameters = specification.parameters
    chooser = RandomChooser(parameters, chosen.seed) if at_random else TreeChooser(parameters, chosen.seed)
    usual = _usual_point(specification, points)
    searched = [*tried_points(chooser, points.evaluate, chosen.points, chosen.batch)]
    tried = [item for item in searched if not item.refusal]
    if not tried:
        last_reason = searched[-1].refusal
        raise InputError(f"{specification.path}: no point can be run; reason for the last point: {last_reason}")
    found = max([usual, *tried], key=lambda item: item.badness)
    case = reduced(found, parameters, points.evaluate)
    lost_ratio = lost_ratio_of(tried)
    slices = slices_of(parameters, case, chosen.slices, points.evaluate, lost_ratio) if chosen.slices else []
    record = SearchRecord(
        version=__version__,
        search=str(specification.path),
        figure=chosen.figure,
        statistic=chosen.statistic,
        condition=chosen.condition,
        limit=chosen.limit,
        lost_ratio=lost_ratio,
        parameters=list(parameters),
        points=[_recorded(specification, item) for item in tried],
        left_out=[LeftOutRecord(specification.named(point), reason) for point, reason in points.left_out.items()],
        usual=_recorded(specification, usual),
        found=_recorded(specification, found),
        case=_recorded(specification, case),
        slices=slices,
        coverage=coverage_of(parameters, [item.point for item in tried]),
    )
    return FoundCase(record, case_file(specification, case, points.worst_seed(case.point)))


def _usual_point(specification: SearchSpecification, points: _Points) -> TriedPoint:
    """Run the unchanged scenario; InputError if it cannot be run, or if its drive lacks the figure."""
    chosen = specification.settings
    (usual,) = points.evaluate([specification.usual])
    if usual.refusal:
        raise InputError(f"{specification.path}: the unchanged scenario cannot be run: {usual.refusal}")
    if usual.ratio is None:
        raise InputError(
            f"{specification.path}: the unchanged scenario has no {chosen.figure} {chosen.statistic} over "
            f"{chosen.condition}; choose a figure and a condition that its drive has"
        )
    return usual


def _recorded(specification: SearchSpecification, item: TriedPoint) -> PointRecord:
    jobs = [job.key for job in specification.jobs_at(item.point)]
    return PointRecord(item.ratio, specification.named(item.point), jobs)


def _is_open(store: Store, job: Job) -> bool:
    """Return whether a job must be run: it was not run yet, or failed for a reason other than invalid input."""
    state = store.state(job)
    if state is JobState.FAILED:
        return store.failure(job).cause is not FailureCause.BAD_INPUT
    return state is JobState.WAITING


def _check_host(store: Store, jobs: Sequence[Job]) -> None:
    """Raise an InputError if a job failed for a reason other than invalid input."""
    for job in jobs:
        if _is_open(store, job):
            failure = store.failure(job)
            raise InputError(
                f"{failure.label}: {failure.cause}: {one_line(failure.message)}; repeat the command to continue "
                "the search"
            )


def case_file(specification: SearchSpecification, case: TriedPoint, seed: int) -> str:
    """Return the text of a suite file that repeats a case with a seed, and judges the case.

    A warning reports that a suite cannot limit the searched number, so that the case is not judged.
    """
    point = case.point
    chosen = specification.settings
    settings = {**specification.changes, **specification.settings_at(point)}
    settings.pop("seed", None)
    content: dict[str, Any] = {
        "sources": [{"simulate": str(specification.scenario), "seeds": [seed], "set": to_plain(settings)}],
        "tasks": ["localise"],
        "conditions": list(specification.scoring.conditions),
        **{name: value for name, value in asdict(specification.running).items() if name not in WITHOUT_EFFECT},
    }
    if faults := specification.faults_at(point):
        content |= {"perturb": [faults], "nominal": False}
    if limits := _limits_of(chosen, specification.scoring.conditions[0]):
        content["limits"] = limits
    else:
        _log.warning(
            f"{specification.path}: a limits file cannot state the limit {chosen.limit:g} on the {chosen.statistic} of "
            f"{chosen.figure}{f', part {chosen.part}' if chosen.part else ''}, so {CASE} repeats the case without a "
            "verdict"
        )
    ratio = ratio_text(case.ratio)
    head = f"# Found by a search for {chosen.figure} {chosen.statistic}, limit {chosen.limit:g}: {ratio}.\n"
    return head + yaml.safe_dump(content, sort_keys=False)


def _limits_of(chosen: SearchSettings, condition: str) -> dict[str, Any]:
    """Return the limit of a search as limits of a suite; empty if a suite cannot limit the searched figure."""
    if fault_of_bound(chosen.figure, chosen.limit) is not None:
        return {}
    for section, numbers in LIMITED_NUMBERS.items():
        for name, number in numbers.items():
            if (number.figure, number.statistic, _part_of(number)) == (chosen.figure, chosen.statistic, chosen.part):
                block: dict[str, Any] = {name: chosen.limit}
                if section is LimitSection.TRAJECTORY:
                    return {"minimum_independent": 1, section.value: [{"condition": condition, **block}]}
                return {section.value: block}
    return {}


def _part_of(number: LimitedNumber) -> str:
    """Return the part of a limited number of a localised drive; empty for the judged row."""
    if number.is_of_worst_call:
        return CallKind.LOCALISATION  # the only kind of call of the drive
    return number.part or ""
