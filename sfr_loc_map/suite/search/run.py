"""A search from its first point to its result; the jobs of each point are results in the folder of a suite."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import yaml

from sfr_loc_map import __version__
from sfr_loc_map.errors import InputError
from sfr_loc_map.inputs import one_line
from sfr_loc_map.metrics.score_json import to_plain
from sfr_loc_map.suite.running.job import Job
from sfr_loc_map.suite.running.job_outcome import FailureCause, JobState
from sfr_loc_map.suite.running.store import Store
from sfr_loc_map.suite.search.specification import UNUSED, Point, SearchSpecification
from sfr_loc_map.suite.search.worst_case import (
    Coverage,
    RandomChooser,
    Slice,
    TreeChooser,
    Tried,
    coverage_of,
    rank_correlations,
    reduced,
    search_worst,
    slices_of,
)

SCHEMA = "sfr-search/1"
CASE = "case.yaml"
WITHOUT_FIGURE = 2.0
"""Ratio of a drive that lacks the figure, for example a lost drive. It misses the limit by an unknown amount."""
RunJobs = Callable[[Sequence[Job]], None]
"""Runs jobs and stores their results in the folder of the suite."""


@dataclass(frozen=True, slots=True)
class SearchResult:
    """The result of a search."""

    specification: SearchSpecification
    usual: Tried  #: The unchanged scenario.
    left_out: Mapping[Point, str]  #: Points whose scenario cannot be run, with the reason. They do not count as misses.
    tried: tuple[Tried, ...]  #: Points of the search with a result, in the order of the search.
    found: Tried  #: The point with the least margin.
    case: Tried  #: The smallest change of the scenario that still misses the limit; `found` if it meets the limit.
    slices: tuple[Slice, ...]
    coverage: tuple[Coverage, ...]
    correlations: tuple[float, ...]  #: Rank correlation of each parameter with the ratio.

    @property
    def until_first_miss(self) -> int | None:
        """Number of points up to the first miss; None without a miss."""
        return next((number for number, item in enumerate(self.tried, 1) if item.fails), None)

    def to_dict(self) -> dict[str, Any]:
        """Return the result as JSON values."""
        specification = self.specification
        chosen = specification.settings
        head = {"schema": SCHEMA, "version": __version__, "search": str(specification.path)}
        head |= {name: getattr(chosen, name) for name in ("figure", "statistic", "condition", "limit")}
        points = [
            {"ratio": item.ratio, "jobs": [job.key for job in specification.jobs_at(item.point)]}
            | {"point": self.named(item.point)}
            for item in self.tried
        ]
        of_cases = {
            name: {"ratio": item.ratio, "point": self.named(item.point)}
            for name, item in (("usual", self.usual), ("found", self.found), ("case", self.case))
        }
        left_out = [{"point": self.named(point), "reason": reason} for point, reason in self.left_out.items()]
        parts = {name: to_plain(getattr(self, name)) for name in ("slices", "coverage", "correlations")}
        return {
            **head,
            "parameters": to_plain(specification.parameters),
            "points": points,
            "left_out": left_out,
            **of_cases,
            **parts,
        }

    def named(self, point: Point) -> dict[str, float]:
        """Return the values of a point by parameter name."""
        pairs = zip(self.specification.parameters, point, strict=True)
        return {parameter.name: value for parameter, value in pairs}


def find_worst_case(
    specification: SearchSpecification, store: Store, run_jobs: RunJobs, *, at_random: bool = False
) -> SearchResult:
    """Search, reduce the worst point and compute slices through it; points with results are not run again."""
    points = _Points(specification, store, run_jobs)
    try:
        return _search(specification, points, at_random=at_random)
    finally:  # also after an interruption, the folder has the plan of its results
        store.save_plan(list(points.planned.values()))


class _Points:
    """Runs the points of a search, and records their jobs and the points that cannot be run."""

    def __init__(self, specification: SearchSpecification, store: Store, run_jobs: RunJobs) -> None:
        self.planned: dict[str, Job] = {}
        self.left_out: dict[Point, str] = {}
        self._specification, self._store, self._run_jobs = specification, store, run_jobs

    def evaluate(self, points: Sequence[Point]) -> list[float | None]:
        """Return the largest ratio of the jobs of each point, None if its scenario cannot be run."""
        jobs = {point: self._specification.jobs_at(point) for point in points}
        by_key = {job.key: job for of_point in jobs.values() for job in of_point}
        self.planned |= by_key
        waiting = [job for job in by_key.values() if _is_open(self._store, job)]
        if waiting:
            self._run_jobs(waiting)
        _check_host(self._store, [job for of_point in jobs.values() for job in of_point])
        return [self._ratio_at(point, jobs[point]) for point in points]

    def _ratio_at(self, point: Point, jobs: Sequence[Job]) -> float | None:
        if refused := [job for job in jobs if self._store.state(job) is JobState.FAILED]:
            self.left_out[point] = one_line(self._store.failure(refused[0]).message)
            return None
        return _worst_ratio(self._specification, self._store, jobs)

    def has_figure(self, point: Point) -> bool:
        """Return whether the results of a point have the figure of the search."""
        jobs = self._specification.jobs_at(point)
        return all(_ratio_of(self._specification, self._store, job) is not None for job in jobs)


def _search(specification: SearchSpecification, points: _Points, *, at_random: bool) -> SearchResult:
    chosen, parameters, usual_point = specification.settings, specification.parameters, specification.usual
    chooser = RandomChooser(parameters, chosen.seed) if at_random else TreeChooser(parameters, chosen.seed)
    (usual_ratio,) = points.evaluate([usual_point])
    if usual_ratio is None:
        reason = points.left_out[usual_point]
        raise InputError(f"{specification.path}: the unchanged scenario cannot be run: {reason}")
    if not points.has_figure(usual_point):
        raise InputError(
            f"{specification.path}: the unchanged scenario has no {chosen.figure} {chosen.statistic} over "
            f"{chosen.condition}; choose a figure and a condition that its drive has"
        )
    tried = list(search_worst(chooser, points.evaluate, chosen.runs, chosen.batch))
    if not tried:
        last_reason = [*points.left_out.values()][-1]
        raise InputError(f"{specification.path}: no point can be run; reason for the last point: {last_reason}")
    found = max(tried, key=lambda item: item.ratio)
    case = reduced(found, parameters, points.evaluate)
    slices = slices_of(parameters, case, tried, chosen.slices, points.evaluate) if chosen.slices else []
    return SearchResult(
        specification=specification,
        usual=Tried(usual_point, usual_ratio),
        left_out=points.left_out,
        tried=tuple(tried),
        found=found,
        case=case,
        slices=tuple(slices),
        coverage=tuple(coverage_of(parameters, [item.point for item in tried])),
        correlations=tuple(rank_correlations(tried, len(parameters))),
    )


def _is_open(store: Store, job: Job) -> bool:
    """Return whether a job must be run: it was not run yet, or failed for a reason other than invalid input."""
    state = store.state(job)
    if state is JobState.FAILED:
        return store.failure(job).cause is not FailureCause.BAD_INPUT
    return state is JobState.WAITING


def _check_host(store: Store, jobs: Sequence[Job]) -> None:
    """Raise an InputError if a job failed for a reason other than its scenario."""
    for job in jobs:
        if _is_open(store, job):
            failure = store.failure(job)
            raise InputError(
                f"{failure.label}: {failure.cause}: {one_line(failure.message)}; repeat the command to continue "
                "the search"
            )


def _worst_ratio(specification: SearchSpecification, store: Store, jobs: Sequence[Job]) -> float:
    """Return the largest ratio of the jobs of a point; a drive that lacks the figure (lost) is a miss."""
    ratios = [_ratio_of(specification, store, job) for job in jobs]
    return max(WITHOUT_FIGURE if ratio is None else ratio for ratio in ratios)


def _ratio_of(specification: SearchSpecification, store: Store, job: Job) -> float | None:
    """Return the ratio of a job, None if the result or the figure is missing."""
    return specification.ratio_of(store.score(job)) if store.state(job) is JobState.DONE else None


def case_file(result: SearchResult) -> str:
    """Return the text of a suite file that repeats the found case."""
    specification, point = result.specification, result.case.point
    settings = {**specification.changes, **specification.settings_at(point)}
    settings.pop("seed", None)
    content: dict[str, Any] = {
        "sources": [
            {"simulate": str(specification.scenario), "seeds": list(specification.seeds), "set": to_plain(settings)}
        ],
        "tasks": ["localise"],
        "conditions": list(specification.scoring.conditions),
        **{name: value for name, value in asdict(specification.running).items() if name not in UNUSED},
    }
    if faults := specification.faults_at(point):
        content["perturb"] = [faults]
    ratio = f"{result.case.ratio:.3g} times the limit of {specification.settings.limit:g}"
    head = f"# Found by a search: {specification.settings.figure} {specification.settings.statistic} is {ratio}.\n"
    return head + yaml.safe_dump(content, sort_keys=False)
