"""From the file of a suite to its tasks."""

from __future__ import annotations

import glob
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from sfr_loc_map.config import build, flatten, load_yaml
from sfr_loc_map.errors import ConfigError, InputError, SfrError
from sfr_loc_map.inputs import hash_path
from sfr_loc_map.simulation.config import SimulationConfig
from sfr_loc_map.suite.fingerprint import SourceFacts, code_fingerprint
from sfr_loc_map.suite.remote import expand, is_remote, remote_facts
from sfr_loc_map.suite.specification import SourceEntry, SuiteSpecification
from sfr_loc_map.suite.task import NO_CONFIGURATION, SourceKind, Task, TaskKind, TaskSource, digest

READERS = 8
"""Sources that are hashed, or asked for, at a time: of many large ones this takes longer than their tasks."""
FactsOf = Callable[[Path], SourceFacts]
"""Tells what a source holds."""


@dataclass(frozen=True, slots=True)
class Refusal:
    """A source that cannot be read.

    Attributes:
        path: The source.
        reason: What is wrong with it.
    """

    path: str
    reason: str


@dataclass(frozen=True, slots=True)
class Plan:
    """The tasks of a suite.

    Attributes:
        tasks: In the order of the file; the same work is listed once.
        refusals: Sources that cannot be read.
    """

    tasks: tuple[Task, ...]
    refusals: tuple[Refusal, ...]


def make_plan(specification: SuiteSpecification, facts_of: FactsOf) -> Plan:
    """Return the tasks of a suite.

    Args:
        specification: The suite.
        facts_of: Tells what a source holds; raises an error for one that cannot be read.

    Raises:
        ConfigError: If a path or glob matches nothing, a simulation's settings are wrong, or there is no task at all.
    """
    folder = specification.path.absolute().parent
    named = [source for entry in specification.sources for source in _sources(entry, folder)]
    with ThreadPoolExecutor(READERS) as readers:
        found = list(readers.map(lambda source: _known_or_refused(source, facts_of), named))
    sources = [item for item in found if not isinstance(item, Refusal)]
    refusals = [item for item in found if isinstance(item, Refusal)]
    tasks = {task.key: task for task in _tasks(specification, _renamed(sources))}
    if not tasks and not refusals:
        raise ConfigError(f"{specification.path}: no task: the sources have nothing that 'tasks' asks for")
    return Plan(tuple(tasks.values()), tuple(refusals))


def _sources(entry: SourceEntry, folder: Path) -> Iterator[TaskSource]:
    """Yield the sources of an entry, those of files without their hashes."""
    if entry.truth is not None:
        names = (str(folder / entry.path), str(folder / entry.truth))
        yield TaskSource(name=Path(entry.path).name, kind=SourceKind.ESTIMATE, path=names[0], truth=names[1], sha256="")
    elif entry.seeds is not None:
        yield from _simulations(entry, folder)
    elif is_remote(entry.path):
        urls = expand(entry.path)
        if not urls:
            raise ConfigError(f"source '{entry.path}': nothing there matches; give an existing URL or glob")
        for url in urls:
            yield TaskSource(
                name=url.rstrip("/").rpartition("/")[2], kind=SourceKind.REMOTE, path=url, sha256=entry.sha256
            )
    else:
        found = sorted(glob.glob(str(folder / entry.path), recursive=True))
        if not found:
            raise ConfigError(f"source '{entry.path}': nothing in '{folder}' matches; give an existing path or glob")
        for path in found:
            yield TaskSource(name=Path(path).name, kind=SourceKind.FILE, path=path, sha256="")


def _simulations(entry: SourceEntry, folder: Path) -> Iterator[TaskSource]:
    scenario = folder / entry.path
    values: dict[str, Any] = load_yaml(scenario) | {"seed": 0}
    config = build(SimulationConfig, values, origin=str(scenario))
    for seed in entry.seeds or ():
        changed = flatten(config) | dict(entry.settings or {}) | {"seed": seed}
        settings = flatten(build(SimulationConfig, changed, origin=f"{scenario}: 'set'"))
        name = f"{scenario.stem}-{seed}"
        kind = SourceKind.SIMULATED
        yield TaskSource(name=name, kind=kind, path=str(scenario), settings=settings, sha256=digest(settings))


def _known_or_refused(source: TaskSource, facts_of: FactsOf) -> tuple[TaskSource, tuple[TaskKind, ...]] | Refusal:
    try:
        return _known(source, facts_of)
    except SfrError as error:
        return Refusal(source.path, str(error))


def _known(source: TaskSource, facts_of: FactsOf) -> tuple[TaskSource, tuple[TaskKind, ...]]:
    """Return a source with its hash, and the tasks that it has the data for."""
    if source.kind is SourceKind.ESTIMATE:
        for path in (source.path, source.truth):
            if not Path(path).exists():
                raise InputError(f"there is no '{path}': give an estimate and its truth")
        hashes = digest([hash_path(Path(source.path)), hash_path(Path(source.truth))])
        return replace(source, sha256=hashes), (TaskKind.SCORE,)
    if source.kind is SourceKind.SIMULATED:
        config = build(SimulationConfig, source.settings)
        drive, panorama = config.drive.enabled, config.panorama.enabled
        return source, _possible(drive=drive, panorama=panorama)
    if source.kind is SourceKind.REMOTE:
        version = remote_facts(source.path).version
        known = replace(source, sha256=source.sha256 or version, version=version)
        return known, _possible(drive=True, panorama=True)
    facts = facts_of(Path(source.path))
    possible = _possible(drive=facts.pairs > 0, panorama=facts.nav_pairs > 0)
    return replace(source, sha256=facts.sha256), possible


def _possible(*, drive: bool, panorama: bool) -> tuple[TaskKind, ...]:
    offered = ((TaskKind.LOCALISE, drive), (TaskKind.MAP, panorama), (TaskKind.REPLAY, drive or panorama))
    return tuple(kind for kind, there in offered if there)


def _renamed(
    sources: list[tuple[TaskSource, tuple[TaskKind, ...]]],
) -> list[tuple[TaskSource, tuple[TaskKind, ...]]]:
    """Give sources of one name the shortest ends of their paths that tell them apart."""
    names = [source.name for source, _ in sources]
    renamed = []
    for source, kinds in sources:
        if names.count(source.name) > 1 and source.kind is not SourceKind.SIMULATED:
            source = replace(source, name="/".join(Path(source.path).parts[-3:]))
        renamed.append((source, kinds))
    return renamed


def _tasks(specification: SuiteSpecification, sources: list[tuple[TaskSource, tuple[TaskKind, ...]]]) -> Iterator[Task]:
    settings, code = specification.settings, code_fingerprint()
    for source, possible in sources:
        for kind in possible:
            asked = specification.tasks
            wanted = kind is not TaskKind.REPLAY if asked is None else kind in asked or kind is TaskKind.SCORE
            if not wanted:
                continue
            whole = kind is TaskKind.SCORE
            faults = ("",) if whole else specification.perturb
            configurations = {NO_CONFIGURATION: {}} if whole else specification.configurations
            for fault in faults:
                for name, parameters in configurations.items():
                    for repeat in range(settings.repeats):
                        yield Task(
                            kind=kind,
                            source=source,
                            faults=fault,
                            fault_seed=settings.seed,
                            configuration=name,
                            parameters=_of_kind(parameters, kind),
                            start=settings.start,
                            scoring=specification.scoring,
                            repeat=repeat,
                            alone=settings.timing,
                            threads=settings.threads,
                            code=code,
                            limits=specification.limits,
                            cache_mb=settings.cache_mb,
                        )


def _of_kind(parameters: Any, kind: TaskKind) -> dict[str, object]:  # noqa: ANN401 - a mapping of any values
    """Return the parameters that a task uses: those of the other part do not change it."""
    sections = {TaskKind.LOCALISE: ("localisation.",), TaskKind.MAP: ("mapping.",)}
    prefixes = sections.get(kind, ("localisation.", "mapping."))
    return {name: value for name, value in parameters.items() if name.startswith(prefixes)}
