"""Makes the jobs of a suite from its file: inspects each source and combines sources, faults and configurations."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import product
from pathlib import Path

from sfr_loc_map.errors import ConfigError, SfrError
from sfr_loc_map.suite.running.digests import code_fingerprint
from sfr_loc_map.suite.running.drive_copies import with_drives
from sfr_loc_map.suite.running.job import NO_CONFIGURATION, PARAMETERS_OF_TASK, Job, JobSource, JobTask
from sfr_loc_map.suite.running.source_readers import SOURCE_READERS, ReadySource, SourceFacts
from sfr_loc_map.suite.running.specification import Refusal, SuiteSpecification

DEFAULT_TASKS = (JobTask.LOCALISE, JobTask.MAP)
READER_THREADS = 8
"""Number of sources hashed or fetched in parallel. For many large sources, hashing takes longer than the jobs."""


def make_plan(
    specification: SuiteSpecification, facts_of: Callable[[Path], SourceFacts], cache: Path
) -> tuple[list[Job], list[Refusal]]:
    """Return the jobs of a suite in the order of its file, without duplicates, and the refused sources.

    The sources are fetched to `cache` and hashed, and `facts_of` returns the facts of a file. A source is refused if it
    is unreadable, and for each requested task for which it has no data. ConfigError if no source has data for `tasks`.
    """

    def inspected(source: JobSource) -> ReadySource:
        return SOURCE_READERS[source.kind].ready(source, facts_of, cache)

    with ThreadPoolExecutor(READER_THREADS) as readers:
        found = [readers.submit(inspected, source) for source in specification.sources]
    code = code_fingerprint()
    jobs: dict[str, Job] = {}
    refusals = list(specification.refusals)
    ready: list[ReadySource] = []
    for source, future in zip(specification.sources, found, strict=True):
        try:
            ready.append(future.result())
        except SfrError as error:
            refusals.append(Refusal(source.path, str(error)))
    of_drives = with_drives([item.source for item in ready], [item.trace for item in ready])
    for source, item in zip(of_drives, ready, strict=True):
        for job in _jobs(specification, code, source, item.possible):
            known = jobs.setdefault(job.key, job)  # named by the first source and configuration with this job
            if source.name not in (known.source.name, *known.source.identical):
                identical = (*known.source.identical, source.name)
                jobs[job.key] = replace(known, source=replace(known.source, identical=identical))
    if not jobs and not refusals:
        raise ConfigError(f"{specification.path}: there is no job: the sources have no data for 'tasks'")
    for item in ready:
        refusals += _tasks_without_data(specification, item)
    return list(jobs.values()), refusals


def _tasks_without_data(specification: SuiteSpecification, item: ReadySource) -> Iterator[Refusal]:
    """Yield a refusal for each requested task for which a source has no data, or one if it has no data at all."""
    if not item.possible:
        yield Refusal(item.source.name, f"source '{item.source.name}' has no data for any task")
        return
    if JobTask.SCORE in item.possible:
        return
    for task in specification.tasks or ():
        if task not in item.possible:
            yield Refusal(
                f"{item.source.name}, {task}",
                f"source '{item.source.name}' has no data for the task '{task}', which 'tasks' requests of each source",
            )


def _jobs(
    specification: SuiteSpecification, code: str, source: JobSource, possible: tuple[JobTask, ...]
) -> Iterator[Job]:
    settings = specification.settings
    tasks = DEFAULT_TASKS if specification.tasks is None else specification.tasks
    for task in possible:
        faults, configurations = specification.faults, specification.configurations
        if task is JobTask.SCORE:
            faults, configurations = ("",), {NO_CONFIGURATION: {}}
        elif task not in tasks:
            continue
        elif source.variant:
            faults = (source.faults,)
        prefix = PARAMETERS_OF_TASK[task]
        for fault, (name, parameters), repeat in product(faults, configurations.items(), range(settings.repeats)):
            yield Job(
                task=task,
                source=source,
                faults=fault,
                fault_seed=settings.seed,
                configuration=name,
                parameters={key: value for key, value in parameters.items() if key.startswith(prefix)},
                start=settings.start,
                scoring=specification.scoring,
                repeat=repeat,
                threads=settings.threads,
                code=code,
                order_seed=settings.order_seed,
                kept_errors=specification.kept_errors,
            )
