"""Makes the jobs of a suite from its file: inspects each source and combines sources, faults and configurations."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import NamedTuple

from sfr_loc_map.config import build
from sfr_loc_map.errors import ConfigError, SfrError
from sfr_loc_map.simulation.config import SimulationConfig
from sfr_loc_map.suite.running.digests import code_fingerprint, data_hash, files_hash
from sfr_loc_map.suite.running.drive_copies import DriveTrace, trace_of_estimate, trace_of_source, with_drives
from sfr_loc_map.suite.running.job import NO_CONFIGURATION, Job, JobKind, JobSource, SourceKind
from sfr_loc_map.suite.running.sources import fetch
from sfr_loc_map.suite.running.specification import Refusal, SuiteSpecification

NAMED_PARTS = 3  #: Number of parts of a path in the name of a source whose file name is not unique.
DEFAULT_TASKS = (JobKind.LOCALISE, JobKind.MAP)
PARAMETERS_OF_KIND = {JobKind.LOCALISE: "localisation.", JobKind.MAP: "mapping.", JobKind.REPLAY: "", JobKind.SCORE: ""}
"""Prefix of the parameters that change a job of each kind. Other parameters are not part of the job."""
READER_THREADS = 8
"""Number of sources hashed or fetched in parallel. For many large sources, hashing takes longer than the jobs."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SourceFacts:
    """Facts of a source for a plan: hash of the content, numbers of localisation and mapping pairs."""

    sha256: str
    pairs: int
    nav_pairs: int
    trace: DriveTrace = field(default_factory=DriveTrace)  #: Features that copies of the drive share.


def make_plan(
    specification: SuiteSpecification, facts_of: Callable[[Path], SourceFacts], cache: Path
) -> tuple[list[Job], list[Refusal]]:
    """Return the jobs of a suite in the order of its file, without duplicates, and the unreadable sources."""
    sources = with_unique_names(specification.sources)
    with ThreadPoolExecutor(READER_THREADS) as readers:
        found = [readers.submit(_ready, source, facts_of, cache) for source in sources]
    code = code_fingerprint()
    jobs: dict[str, Job] = {}
    refusals = list(specification.refusals)
    ready: list[ReadySource] = []
    for source, facts in zip(sources, found, strict=True):
        try:
            ready.append(facts.result())
        except SfrError as error:
            refusals.append(Refusal(source.path, str(error)))
    of_drives = with_drives([item.source for item in ready], [item.trace for item in ready])
    for source, item in zip(of_drives, ready, strict=True):
        for job in _jobs(specification, code, source, item.possible):
            jobs.setdefault(job.key, job)  # named by the first configuration with this job
    if not jobs and not refusals:
        raise ConfigError(f"{specification.path}: there is no job: the sources have no data for 'tasks'")
    return list(jobs.values()), refusals


def with_unique_names(sources: Sequence[JobSource]) -> list[JobSource]:
    """Return the sources; files of equal name are named by the end of their path, or by the path if the ends are equal.

    Simulations already have distinct names (`with_distinct_simulations`), which the variants of a budget share.
    """
    counts = Counter(source.name for source in sources)
    renamed = []
    for source in sources:
        if counts[source.name] == 1 or source.kind is SourceKind.SIMULATED:
            renamed.append(source)
            continue
        end = "/".join(Path(source.path).parts[-NAMED_PARTS:])
        is_shared = any(other.path != source.path and other.path.endswith(f"/{end}") for other in sources)
        renamed.append(replace(source, name=source.path if is_shared else end))
    return renamed


class ReadySource(NamedTuple):
    """A source that is on this host and was inspected."""

    source: JobSource
    possible: tuple[JobKind, ...]  #: Kinds of jobs for which the source has data.
    trace: DriveTrace  #: Features that copies of the drive share.


def _ready(source: JobSource, facts_of: Callable[[Path], SourceFacts], cache: Path) -> ReadySource:
    """Return a source on this host, fetched if it is remote."""
    trace = DriveTrace()
    if source.kind is SourceKind.ESTIMATE:
        truth_sha256 = files_hash(source.truth)
        hashed = replace(source, sha256=data_hash(source), truth_sha256=truth_sha256)
        return ReadySource(hashed, (JobKind.SCORE,), trace_of_estimate(Path(source.path), Path(source.truth)))
    if source.kind is SourceKind.SIMULATED:
        config = build(SimulationConfig, source.settings)
        drive, panorama = config.drive.enabled, config.panorama.enabled
    else:
        if source.kind is SourceKind.REMOTE:
            source = replace(source, kind=SourceKind.FILE, path=str(fetch(source.path, cache).absolute()))
        facts = facts_of(Path(source.path))
        drive, panorama = facts.pairs > 0, facts.nav_pairs > 0
        source = replace(source, sha256=facts.sha256)
        trace = facts.trace
    return ReadySource(source, possible_kinds(drive=drive, panorama=panorama), trace)


def possible_kinds(*, drive: bool, panorama: bool) -> tuple[JobKind, ...]:
    """Return the kinds of jobs for which a source with localisation pairs or mapping pairs has data."""
    has_data = {JobKind.LOCALISE: drive, JobKind.MAP: panorama, JobKind.REPLAY: drive or panorama}
    return tuple(kind for kind, has in has_data.items() if has)


def _jobs(
    specification: SuiteSpecification, code: str, source: JobSource, possible: tuple[JobKind, ...]
) -> Iterator[Job]:
    settings = specification.settings
    tasks = DEFAULT_TASKS if specification.tasks is None else specification.tasks
    for kind in possible:
        faults, configurations = specification.faults, specification.configurations
        if kind is JobKind.SCORE:
            faults, configurations = ("",), {NO_CONFIGURATION: {}}
        elif kind not in tasks:
            continue
        elif source.variant:
            faults = (source.faults,)
        prefix = PARAMETERS_OF_KIND[kind]
        for fault, (name, parameters), repeat in product(faults, configurations.items(), range(settings.repeats)):
            yield Job(
                kind=kind,
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
                kept_errors=specification.kept_errors,
            )


def inspect_source(path: Path) -> SourceFacts:
    """Return the facts of a source for a plan; raise InputError if the source cannot be read."""
    from sfr_loc_map.io.registry import open_source  # slow import, not needed by a resumed suite

    source = open_source(path)
    pairs, nav_pairs = (0 if part is None else len(part) for part in (source.loc, source.nav))
    sha256 = files_hash(str(path))
    return SourceFacts(sha256=sha256, pairs=pairs, nav_pairs=nav_pairs, trace=trace_of_source(source))
