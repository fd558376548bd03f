"""The plan of a suite: its jobs, which combine each source with each task, fault, configuration and repeat.

A plan is made from the file of a suite, and is saved as `plan.json` (`Store.save_plan`), from which a report reads it.
"""

from __future__ import annotations

import socket
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from datetime import UTC, datetime
from itertools import product
from pathlib import Path
from typing import Any

from msgspec import Struct
from msgspec.structs import replace as struct_replace

from sfr_loc_map.errors import ConfigError, SfrError
from sfr_loc_map.hashes import hash_path
from sfr_loc_map.package_commit import package_commit
from sfr_loc_map.suite.jobs.configurations import Configuration
from sfr_loc_map.suite.jobs.digests import code_fingerprint
from sfr_loc_map.suite.jobs.job import NO_CONFIGURATION, PARAMETERS_OF_TASK, Job, JobTask
from sfr_loc_map.suite.jobs.sources import PlannedSource, Simulation
from sfr_loc_map.suite.planning.drive_copies import with_drives
from sfr_loc_map.suite.planning.looks import Look, extensions_of
from sfr_loc_map.suite.planning.source_inspection import InspectedSource, inspected
from sfr_loc_map.suite.planning.specification import Refusal, SuiteSpecification

DEFAULT_TASKS = (JobTask.LOCALISE, JobTask.MAP)
READER_THREADS = 8
"""Number of sources hashed or fetched in parallel. For many large sources, hashing takes longer than the jobs."""


class PlanFile(Struct, frozen=True):
    """A file from which a plan was made."""

    path: str
    sha256: str

    @classmethod
    def of(cls, path: Path) -> PlanFile:
        """Return a file with the hash of its present content."""
        return cls(str(path.absolute()), hash_path(path))


class SuiteRun(Struct, frozen=True):
    """Code, host and time of a run of a suite."""

    git: dict[str, str | None]  #: Commit, branch and date of the code; None if unknown.
    host: str
    time: str  #: ISO 8601 in UTC.

    @classmethod
    def now(cls) -> SuiteRun:
        """Return the facts of a run that starts now on this host."""
        time = datetime.now(UTC).isoformat(timespec="seconds")
        return cls(package_commit()._asdict(), socket.gethostname(), time)


class PlanOwner(Struct, frozen=True, kw_only=True):
    """The part of a plan that names the suite or the search to which a folder belongs."""

    files: tuple[PlanFile, ...] = ()  #: The file of the suite, and the file of its limits; empty for a search.
    search: str = ""  #: File of the search; empty for a suite.

    @property
    def is_search(self) -> bool:
        """Whether the folder belongs to a search."""
        return bool(self.search)

    @property
    def file(self) -> str:
        """File of the suite or of the search; empty if the plan names none."""
        if self.search:
            return self.search
        return self.files[0].path if self.files else ""


class Plan(PlanOwner, frozen=True, kw_only=True, rename={"stated_limits": "limits"}):
    """The jobs of a suite or of a search: content of `plan.json`."""

    jobs: tuple[Job, ...]  #: In the order of the suite's file, without duplicates.
    refusals: tuple[Refusal, ...] = ()  #: Sources that are unreadable or lack data for a task.
    stated_limits: Mapping[str, Any] = {}  #: The limits as stated in their file; empty if there are none.
    run: SuiteRun  #: The run that made the plan.
    #: Number of the extension that added each drive, also of drives of earlier plans, by kind and hash of the drive.
    extensions: Mapping[str, int] = {}
    looks: tuple[Look, ...] = ()  #: Reports of earlier plans of the folder that had other drives or other limits.

    @classmethod
    def of_search(cls, path: Path, jobs: Iterable[Job] = ()) -> Plan:
        """Return the plan of a search, given the file of the search and the jobs of its points."""
        return cls(jobs=tuple(jobs), run=SuiteRun.now(), search=str(path.absolute()))


def make_plan(specification: SuiteSpecification, cache: Path, earlier: Plan | None = None) -> Plan:
    """Return the plan of a suite, given the earlier plan of its folder.

    The sources are fetched to `cache` and hashed. A source is refused if it is unreadable, and for each requested task
    for which it has no data. ConfigError if no source has data for `tasks`.
    """
    sources, unreadable = _inspected_sources(specification, cache)
    code = code_fingerprint()
    jobs: dict[str, Job] = {}
    of_drives = with_drives([item.source for item in sources], [item.trace for item in sources])
    known = {} if earlier is None else earlier.extensions
    extensions, of_sources = extensions_of([item.source for item in sources], of_drives, known)
    for source, item, extension in zip(of_drives, sources, of_sources, strict=True):
        for job in _jobs(specification, code, source, item.possible, extension):
            first = jobs.setdefault(job.key, job)  # named by the first source and configuration with this job
            if source.name not in (first.source.name, *first.source.identical):
                identical = (*first.source.identical, source.name)
                jobs[job.key] = replace(first, source=struct_replace(first.source, identical=identical))
    refusals = [*specification.refusals, *unreadable]
    if not jobs and not refusals:
        raise ConfigError(f"{specification.path}: there is no job: the sources have no data for 'tasks'")
    for item in sources:
        refusals += _tasks_without_data(specification, item)
    return Plan(
        jobs=tuple(jobs.values()),
        refusals=tuple(refusals),
        stated_limits=specification.stated_limits,
        run=SuiteRun.now(),
        files=tuple(PlanFile.of(path) for path in specification.files),
        extensions=extensions,
    )


def _inspected_sources(specification: SuiteSpecification, cache: Path) -> tuple[list[InspectedSource], list[Refusal]]:
    """Return the readable sources, inspected in parallel, and the unreadable sources."""
    with ThreadPoolExecutor(READER_THREADS) as readers:
        submitted = [readers.submit(inspected, source, cache) for source in specification.sources]
    found: list[InspectedSource] = []
    unreadable: list[Refusal] = []
    for source, future in zip(specification.sources, submitted, strict=True):
        try:
            found.append(future.result())
        except SfrError as error:
            unreadable.append(Refusal(source.name, str(error)))
    return found, unreadable


def _tasks_without_data(specification: SuiteSpecification, item: InspectedSource) -> Iterator[Refusal]:
    """Yield a refusal for each requested task for which a source has no data, or one if it has no data at all."""
    name = item.source.name
    if not item.possible:
        yield Refusal(name, f"source '{name}' has no data for any task")
        return
    if JobTask.SCORE in item.possible:
        return
    for task in specification.requested_tasks:
        if task not in item.possible:
            reason = f"source '{name}' has no data for the task '{task}', which 'tasks' requests of each source"
            yield Refusal(name, reason)


def _jobs(
    specification: SuiteSpecification, code: str, source: PlannedSource, possible: tuple[JobTask, ...], extension: int
) -> Iterator[Job]:
    """Yield the jobs of a source: each requested task with each fault, configuration and repeat."""
    settings = specification.settings
    tasks = specification.requested_tasks or DEFAULT_TASKS
    for task in possible:
        faults, configurations = specification.faults, specification.configurations
        if task is JobTask.SCORE:
            faults, configurations = ("",), {NO_CONFIGURATION: Configuration()}
        elif task not in tasks:
            continue
        elif isinstance(source, Simulation) and source.variant:
            faults = (source.faults,)
        prefix = PARAMETERS_OF_TASK[task]
        for fault, (name, chosen), repeat in product(faults, configurations.items(), range(settings.repeats)):
            yield Job(
                task=task,
                source=source,
                faults=fault,
                fault_seed=settings.seed,
                configuration=name,
                parameters={key: value for key, value in chosen.parameters.items() if key.startswith(prefix)},
                input_files={key: value for key, value in chosen.input_files.items() if key.startswith(prefix)},
                start=settings.start,
                scoring=specification.scoring,
                repeat=repeat,
                threads=settings.threads,
                code=code,
                kept_errors=specification.kept_errors,
                extension=extension,
            )
