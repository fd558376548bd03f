"""The nights of a history: the figures of one suite, as read from its `suite.json`, and the order of the nights."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
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


class JobOfNight(msgspec.Struct, frozen=True):
    """A result or a failure in `suite.json`."""

    pairing: str
    configuration: str
    label: str
    source: str = ""  #: Name or path of the source.
    path: str = ""  #: Path of the source of a result.
    figures: list[tuple[ComparedKind, str, float]] = []  #: Kind, name and value of each figure of a result.

    @property
    def key(self) -> PairKey:
        """Identity of the job among several nights."""
        return PairKey(self.pairing, self.configuration)


class SuiteFile(msgspec.Struct, frozen=True, kw_only=True):
    """The part of `suite.json` that a history requires."""

    git: dict[str, str | None]  #: Commit, branch and date of the code; None if unknown.
    results: list[JobOfNight]
    failures: list[JobOfNight]
    time: str | None = None
    refusals: list[Refusal] = []
    waiting_jobs: list[str] = []
    compared_figures: list[ComparedFigure]  #: The figure of each kind and displayed name.


@dataclass(frozen=True, slots=True)
class Night:
    """One suite of a history. Labels, paths and figures are by job; a job without a result has no figures."""

    name: str
    commit: str | None
    labels: Mapping[PairKey, str]
    paths: Mapping[PairKey, str]  #: Paths of the sources.
    figures: Mapping[PairKey, Mapping[ComparedFigure, float]]
    time: str = ""  #: Time of the run, ISO 8601 in UTC; empty if unknown.
    waiting: tuple[str, ...] = ()  #: Labels of the jobs that were not run, and names of the refused sources.

    @property
    def without_result(self) -> tuple[str, ...]:
        """Labels of the planned jobs without a result, and names of the refused sources."""
        failed = (label for key, label in self.labels.items() if key not in self.figures)
        return (*failed, *self.waiting)

    @classmethod
    def read(cls, folder: Path) -> Night:
        """Read the night from `suite.json` of a folder; InputError if the file is not that of a suite."""
        path = folder / "suite.json"
        with refusing(f"cannot read the figures of '{path}'", f"make it with sfr suite report '{folder}'"):
            suite = _suite_file(parse_json(path.read_bytes()))
            jobs = {job.key: job for job in (*suite.results, *suite.failures)}
            by_name = {(item.kind, item.name): item for item in suite.compared_figures}
            return cls(
                name=str(folder),
                commit=suite.git["commit"],
                labels={key: job.label for key, job in jobs.items()},
                paths={key: job.path or job.source for key, job in jobs.items()},
                figures={job.key: _figures(job, by_name) for job in suite.results},
                time=suite.time or "",
                waiting=(*suite.waiting_jobs, *(refusal.name for refusal in suite.refusals)),
            )

    def without_configurations(self) -> Night:
        """Return the night with jobs that are identified by their work and data only, not by their configuration."""
        labels = {key.without_configuration(): label for key, label in self.labels.items()}
        paths = {key.without_configuration(): path for key, path in self.paths.items()}
        figures = {key.without_configuration(): of_job for key, of_job in self.figures.items()}
        return replace(self, labels=labels, paths=paths, figures=figures)


def _suite_file(content: object) -> SuiteFile:
    """Return the content of `suite.json` from its JSON values; ValueError if it has another schema or type."""
    schema = content.get("schema") if isinstance(content, dict) else None
    if schema != SCHEMA:
        raise ValueError(f"its schema is {schema!s:.40}: {SCHEMA} is required")
    return from_plain(SuiteFile, content)


def _figures(
    job: JobOfNight, by_name: Mapping[tuple[ComparedKind, str], ComparedFigure]
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


def check_order(nights: Sequence[Night]) -> None:
    """Raise MetricsError if a night is given twice, or is older than the night before.

    Nights without a time are not compared by their time.
    """
    places = [Path(night.name).resolve() for night in nights]
    for first, second in combinations(range(len(nights)), 2):
        if places[first] == places[second]:
            raise MetricsError(
                f"'{nights[first].name}' and '{nights[second].name}' are the same run of the suite: give each run once"
            )
    timed = [night for night in nights if night.time]
    for before, after in pairwise(timed):
        if after.time < before.time:
            raise MetricsError(
                f"'{after.name}' ({after.time}) is older than '{before.name}' ({before.time}): give the suites in the "
                "order of their time"
            )
