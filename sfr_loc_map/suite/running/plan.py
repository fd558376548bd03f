"""Makes the jobs of a suite from its file: inspects each source and combines sources, faults and configurations."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import NamedTuple

from msgspec.structs import replace as struct_replace

from sfr_loc_map.errors import ConfigError, SfrError
from sfr_loc_map.suite.running.configurations import Configuration
from sfr_loc_map.suite.running.digests import code_fingerprint
from sfr_loc_map.suite.running.drive_copies import with_drives
from sfr_loc_map.suite.running.job import NO_CONFIGURATION, PARAMETERS_OF_TASK, Job, JobTask
from sfr_loc_map.suite.running.source_readers import InspectedSource, SourceFacts, inspected
from sfr_loc_map.suite.running.sources import PlannedSource, Simulation
from sfr_loc_map.suite.running.specification import Refusal, SuiteSpecification

DEFAULT_TASKS = (JobTask.LOCALISE, JobTask.MAP)
READER_THREADS = 8
"""Number of sources hashed or fetched in parallel. For many large sources, hashing takes longer than the jobs."""


class PlannedJobs(NamedTuple):
    """The jobs of a suite, and the sources without jobs."""

    jobs: list[Job]  #: In the order of the suite's file, without duplicates.
    refusals: list[Refusal]


def make_plan(specification: SuiteSpecification, facts_of: Callable[[Path], SourceFacts], cache: Path) -> PlannedJobs:
    """Return the jobs of a suite and the refused sources.

    The sources are fetched to `cache` and hashed, and `facts_of` returns the facts of a recording. A source is refused
    if it is unreadable, and for each requested task for which it has no data. ConfigError if no source has data for
    `tasks`.
    """
    sources, refusals = _inspected_sources(specification, facts_of, cache)
    code = code_fingerprint()
    jobs: dict[str, Job] = {}
    of_drives = with_drives([item.source for item in sources], [item.trace for item in sources])
    for source, item in zip(of_drives, sources, strict=True):
        for job in _jobs(specification, code, source, item.possible):
            known = jobs.setdefault(job.key, job)  # named by the first source and configuration with this job
            if source.name not in (known.source.name, *known.source.identical):
                identical = (*known.source.identical, source.name)
                jobs[job.key] = replace(known, source=struct_replace(known.source, identical=identical))
    refusals = [*specification.refusals, *refusals]
    if not jobs and not refusals:
        raise ConfigError(f"{specification.path}: there is no job: the sources have no data for 'tasks'")
    for item in sources:
        refusals += _tasks_without_data(specification, item)
    return PlannedJobs([*jobs.values()], refusals)


def _inspected_sources(
    specification: SuiteSpecification, facts_of: Callable[[Path], SourceFacts], cache: Path
) -> tuple[list[InspectedSource], list[Refusal]]:
    """Return the readable sources, inspected in parallel, and the unreadable sources."""
    with ThreadPoolExecutor(READER_THREADS) as readers:
        submitted = [readers.submit(inspected, source, facts_of, cache) for source in specification.sources]
    found: list[InspectedSource] = []
    unreadable: list[Refusal] = []
    for source, future in zip(specification.sources, submitted, strict=True):
        try:
            found.append(future.result())
        except SfrError as error:
            unreadable.append(Refusal(source.name, str(error), entry=source.entry, source=source.location))
    return found, unreadable


def _tasks_without_data(specification: SuiteSpecification, item: InspectedSource) -> Iterator[Refusal]:
    """Yield a refusal for each requested task for which a source has no data, or one if it has no data at all."""
    name, entry, location = item.source.name, item.source.entry, item.source.location
    if not item.possible:
        yield Refusal(name, f"source '{name}' has no data for any task", entry=entry, source=location)
        return
    if JobTask.SCORE in item.possible:
        return
    for task in specification.tasks or ():
        if task not in item.possible:
            reason = f"source '{name}' has no data for the task '{task}', which 'tasks' requests of each source"
            yield Refusal(name, reason, entry=entry, source=location, task=task)


def _jobs(
    specification: SuiteSpecification, code: str, source: PlannedSource, possible: tuple[JobTask, ...]
) -> Iterator[Job]:
    """Yield the jobs of a source: each requested task with each fault, configuration and repeat."""
    settings = specification.settings
    tasks = DEFAULT_TASKS if specification.tasks is None else specification.tasks
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
                order_seed=settings.order_seed,
                kept_errors=specification.kept_errors,
            )
