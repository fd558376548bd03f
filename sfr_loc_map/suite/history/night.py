"""The nights of a history: the figures of one suite each, as read from its `suite.json`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from pathlib import Path

import msgspec

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.inputs import refusing
from sfr_loc_map.json_yaml import parse_json
from sfr_loc_map.metrics.stored.score_json import from_plain
from sfr_loc_map.suite.jobs.job import PairKey
from sfr_loc_map.suite.planning.specification import Refusal
from sfr_loc_map.suite.statistics.figures import ComparedFigure, ComparedKind
from sfr_loc_map.suite.statistics.summary import SCHEMA

MAX_NUMBER = 1e100  #: Largest accepted value of a figure; squares and sums of such values are finite.


@dataclass(frozen=True, slots=True)
class NightJob:
    """A job in one night."""

    label: str
    path: str  #: Path of the source.
    figures: Mapping[ComparedFigure, float] | None  #: None without a result.


@dataclass(frozen=True, slots=True)
class Night:
    """One run of the suite."""

    name: str  #: Folder of the run.
    commit: str | None
    jobs: Mapping[PairKey, NightJob]  #: The jobs with a result or a failure.
    time: str = ""  #: Time of the run, ISO 8601 in UTC; empty if unknown.
    waiting: tuple[str, ...] = ()  #: Labels of the jobs that were not run, and names of the refused sources.
    not_run: tuple[str, ...] = ()  #: Labels of the jobs that were not required, because the limits were decided.

    @property
    def without_result(self) -> tuple[str, ...]:
        """Labels of the planned jobs without a result, and names of the refused sources."""
        failed = (job.label for job in self.jobs.values() if job.figures is None)
        return (*failed, *self.waiting)

    @property
    def planned_labels(self) -> set[str]:
        """Labels of all planned jobs, and names of the refused sources."""
        return {*(job.label for job in self.jobs.values()), *self.waiting, *self.not_run}


def read_nights(folders: Sequence[Path]) -> list[Night]:
    """Read the nights of a history from the `suite.json` of each folder.

    InputError if a file is not that of a suite. MetricsError if a night is given twice, or is older than the night
    before. Nights without a time are not compared by their time.
    """
    nights = [_read_night(folder) for folder in folders]
    for first, second in combinations(folders, 2):
        if first.resolve() == second.resolve():
            raise MetricsError(f"'{first}' and '{second}' are the same night: give the folder of each night once")
    for before, after in pairwise(night for night in nights if night.time):
        if after.time < before.time:
            raise MetricsError(
                f"'{after.name}' ({after.time}) is older than '{before.name}' ({before.time}): give the suites in the "
                "order of their time"
            )
    return nights


class _StoredJob(msgspec.Struct, frozen=True):
    """A result or a failure in `suite.json`."""

    pairing: str
    configuration: str
    label: str
    source: str = ""  #: Path of the source of a failure; name of the source of a result.
    path: str = ""  #: Path of the source of a result.
    figures: list[tuple[ComparedKind, str, float]] = []  #: Kind, name and value of each figure of a result.

    @property
    def key(self) -> PairKey:
        """Identity of the job among several nights."""
        return PairKey(self.pairing, self.configuration)


class _StoredSuite(msgspec.Struct, frozen=True, kw_only=True):
    """The part of `suite.json` that a history requires."""

    git: dict[str, str | None]  #: Commit, branch and date of the code; None if unknown.
    results: list[_StoredJob]
    failures: list[_StoredJob]
    time: str | None = None
    refusals: list[Refusal] = []
    waiting_jobs: list[str] = []
    not_run: list[str] = []
    compared_figures: list[ComparedFigure]  #: The figure of each kind and displayed name.


def _read_night(folder: Path) -> Night:
    path = folder / "suite.json"
    with refusing(f"cannot read the figures of '{path}'", f"make it with sfr suite report '{folder}'"):
        content = parse_json(path.read_bytes())
        schema = content.get("schema") if isinstance(content, dict) else None
        if schema != SCHEMA:
            raise ValueError(f"its schema is {schema!s:.40}: {SCHEMA} is required")
        suite = from_plain(_StoredSuite, content)
        by_name = {(item.kind, item.name): item for item in suite.compared_figures}
        jobs = {job.key: NightJob(job.label, job.path, _figures(job, by_name)) for job in suite.results}
        for job in suite.failures:
            jobs.setdefault(job.key, NightJob(job.label, job.source, None))
        return Night(
            name=str(folder),
            commit=suite.git["commit"],
            jobs=jobs,
            time=suite.time or "",
            waiting=(*suite.waiting_jobs, *(refusal.name for refusal in suite.refusals)),
            not_run=tuple(suite.not_run),
        )


def _figures(
    job: _StoredJob, by_name: Mapping[tuple[ComparedKind, str], ComparedFigure]
) -> dict[ComparedFigure, float]:
    """Return the figures of a result.

    ValueError for an unknown figure, and for a value that is negative, NaN or above `MAX_NUMBER`.
    """
    found = {}
    for kind, name, value in job.figures:
        if not 0.0 <= value <= MAX_NUMBER:
            raise ValueError(f"{name} is {value:g}: a number of 0 to {MAX_NUMBER:g} is required")
        if (kind, name) not in by_name:
            raise ValueError(f"compared_figures does not have {name}")
        found[by_name[kind, name]] = value
    return found
