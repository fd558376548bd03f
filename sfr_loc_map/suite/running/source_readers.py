"""The readers of sources, one for each kind: the entries of a suite's file, and how a plan and a job access the data.

To add a kind, add a member to `SourceKind` (job.py), and here a class with its row in `SOURCE_READERS`.
"""

from __future__ import annotations

import glob
import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

from sfr_loc_map.configuration.parameters import build, flatten
from sfr_loc_map.configuration.yaml_file import load_yaml
from sfr_loc_map.errors import ConfigError, InputError, SfrError, naming_key
from sfr_loc_map.simulation.config import SimulationConfig
from sfr_loc_map.suite.running.digests import (
    estimate_hash,
    file_state,
    files_hash,
    files_of_estimate,
    files_of_source,
    input_hashes,
)
from sfr_loc_map.suite.running.drive_copies import DriveTrace, trace_of_estimate, trace_of_source
from sfr_loc_map.suite.running.job import JobSource, JobTask, SourceKind, digest, tasks_for
from sfr_loc_map.suite.running.source_cache import expand, fetch, rendered
from sfr_loc_map.suite.running.source_names import last_part, pattern_in

UNREADABLE = "unreadable"  #: State of a source of which a file cannot be read.


@dataclass(frozen=True, slots=True, kw_only=True)
class SourceFacts:
    """Facts of a file for a plan: hash of the content, numbers of localisation and mapping pairs."""

    sha256: str
    pairs: int
    nav_pairs: int
    trace: DriveTrace = field(default_factory=DriveTrace)  #: Features that copies of the drive share.


class ReadySource(NamedTuple):
    """A source that is on this host and was inspected."""

    source: JobSource
    possible: tuple[JobTask, ...]  #: Tasks for which the source has data.
    trace: DriveTrace = DriveTrace()  #: Features that copies of the drive share.


class SourceReader(ABC):
    """Reads the sources of one kind."""

    @abstractmethod
    def accepts(self, entry: object) -> bool:
        """Return whether an entry of `sources` in the suite's file is of this kind."""

    @abstractmethod
    def sources(self, entry: object, folder: Path, origin: str) -> Iterator[JobSource]:
        """Yield the sources of an accepted entry; paths are relative to `folder`, errors name `origin`."""

    @abstractmethod
    def ready(self, source: JobSource, facts_of: Callable[[Path], SourceFacts], cache: Path) -> ReadySource:
        """Return a source on this host with its hashes; `facts_of` inspects a file."""

    def local_path(self, source: JobSource, cache: Path) -> Path:
        """Return the path at which a job reads the source."""
        return Path(source.path)

    def files(self, source: JobSource) -> tuple[Path, ...]:
        """Return the files and folders that the hash of a planned source covers."""
        return files_of_source(Path(source.path))


class FileSource(SourceReader):
    """A recording on this host: a path or a glob."""

    def accepts(self, entry: object) -> bool:
        """Return whether the entry is a text."""
        return isinstance(entry, str) and entry != ""

    def sources(self, entry: object, folder: Path, origin: str) -> Iterator[JobSource]:
        """Yield a source for each match; a path that exists is no glob, even if its name has brackets."""
        named, pattern = str(folder / str(entry)), pattern_in(folder, str(entry))
        paths = [named] if os.path.exists(named) else sorted(glob.glob(pattern, recursive=True))
        if not paths:
            raise InputError(f"source '{entry}': no match in '{folder}'; give an existing path or glob")
        for path in paths:
            yield JobSource(name=last_part(path), kind=SourceKind.FILE, path=path, sha256="")

    def ready(self, source: JobSource, facts_of: Callable[[Path], SourceFacts], cache: Path) -> ReadySource:
        """Inspect the file."""
        state = state_of(source)  # before the files are hashed, so that a later change is detected
        facts = facts_of(Path(source.path))
        possible = tasks_for(has_drive=facts.pairs > 0, has_panorama=facts.nav_pairs > 0)
        return ReadySource(replace(source, sha256=facts.sha256, state=state), possible, facts.trace)


class RemoteSource(FileSource):
    """A recording that fsspec reads: a URL, which may be a glob. The plan copies the recording to a file."""

    def accepts(self, entry: object) -> bool:
        """Return whether the entry is a URL."""
        return isinstance(entry, str) and "://" in entry

    def sources(self, entry: object, folder: Path, origin: str) -> Iterator[JobSource]:
        """Yield a source for each match on the server."""
        urls = expand(str(entry))
        if not urls:
            raise InputError(f"source '{entry}': no match; give an existing URL or glob")
        for url in urls:
            yield JobSource(name=last_part(url), kind=SourceKind.REMOTE, path=url, sha256="")

    def ready(self, source: JobSource, facts_of: Callable[[Path], SourceFacts], cache: Path) -> ReadySource:
        """Fetch and inspect the file."""
        path = fetch(source.path, cache).absolute()
        return super().ready(replace(source, kind=SourceKind.FILE, path=str(path)), facts_of, cache)


class EstimateSource(SourceReader):
    """An estimate with its ground truth, for a score."""

    def accepts(self, entry: object) -> bool:
        """Return whether the entry has the keys of an estimate, each with a path."""
        if not isinstance(entry, Mapping) or set(entry) != {"estimate", "truth"}:
            return False
        return all(isinstance(path, str) for path in entry.values())

    def sources(self, entry: object, folder: Path, origin: str) -> Iterator[JobSource]:
        """Yield the source."""
        assert isinstance(entry, Mapping)
        path, truth = (str(folder / entry[name]) for name in ("estimate", "truth"))
        yield JobSource(name=last_part(path), kind=SourceKind.ESTIMATE, path=path, truth=truth, sha256="")

    def ready(self, source: JobSource, facts_of: Callable[[Path], SourceFacts], cache: Path) -> ReadySource:
        """Hash the files."""
        estimate, truth = Path(source.path), Path(source.truth)
        hashed = replace(
            source,
            state=state_of(source),  # before the files are hashed, so that a later change is detected
            sha256=estimate_hash(estimate, truth),
            truth_sha256=files_hash(truth),
            input_sha256=input_hashes(estimate, truth),
        )
        return ReadySource(hashed, (JobTask.SCORE,), trace_of_estimate(estimate, truth))

    def files(self, source: JobSource) -> tuple[Path, ...]:
        """Return the estimate, its truth and its calls, each with its configuration."""
        return files_of_estimate(Path(source.path), Path(source.truth))


class SimulatedSource(SourceReader):
    """A drive or a panorama that is rendered from the settings of a scenario, one for each seed."""

    def accepts(self, entry: object) -> bool:
        """Return whether the entry names a scenario."""
        return isinstance(entry, Mapping) and isinstance(entry.get("simulate"), str)

    def sources(self, entry: object, folder: Path, origin: str) -> Iterator[JobSource]:
        """Yield a source for each seed."""
        assert isinstance(entry, Mapping)
        seeds, stated = entry.get("seeds", [0]), entry.get("set", {})
        is_whole = isinstance(seeds, list) and all(type(seed) is int for seed in seeds)
        if set(entry) - {"simulate", "seeds", "set"} or not is_whole or not seeds or not isinstance(stated, Mapping):
            raise ConfigError(
                f"{origin}: 'simulate' accepts 'seeds' (a list of whole numbers) and 'set' (settings as NAME: VALUE)"
            )
        with naming_key(f"{origin}: 'set'"):
            changes = flatten(stated)
        if "seed" in changes:
            raise ConfigError(f"{origin}: 'seed' in 'set' has no effect: give 'seeds'")
        scenario = folder / entry["simulate"]
        if not scenario.exists():
            raise InputError(f"source 'simulate: {entry['simulate']}': '{scenario}' is missing; give a scenario file")
        settings = changed_scenario(scenario, changes, f"{origin}: 'set'")
        for seed in seeds:
            yield simulated_source(scenario, settings, seed, f"{origin}: 'seeds'")

    def ready(self, source: JobSource, facts_of: Callable[[Path], SourceFacts], cache: Path) -> ReadySource:
        """Return the source unchanged, because its settings identify the data."""
        config = build(SimulationConfig, source.settings)
        possible = tasks_for(has_drive=config.drive.enabled, has_panorama=config.panorama.enabled)
        return ReadySource(source, possible)

    def local_path(self, source: JobSource, cache: Path) -> Path:
        """Return the path of the rendered source."""
        return rendered(source, cache)

    def files(self, source: JobSource) -> tuple[Path, ...]:
        """Return no file, because the settings identify the data."""
        return ()


SOURCE_READERS: Mapping[SourceKind, SourceReader] = {
    SourceKind.REMOTE: RemoteSource(),
    SourceKind.FILE: FileSource(),
    SourceKind.ESTIMATE: EstimateSource(),
    SourceKind.SIMULATED: SimulatedSource(),
}
"""The reader of each kind. The first reader that accepts an entry is used. The reader of URLs therefore precedes the
reader of paths."""


def read_sources(entry: object, folder: Path, origin: str) -> Iterator[JobSource]:
    """Yield the sources of an entry of a suite's file; raise ConfigError if no kind accepts the entry."""
    reader = next((reader for reader in SOURCE_READERS.values() if reader.accepts(entry)), None)
    if reader is None:
        raise ConfigError(
            f"{origin}: a path, a URL, 'simulate: SCENARIO', or 'estimate: EST' with 'truth: TRUTH' is required"
        )
    yield from reader.sources(entry, folder, origin)


def state_of(source: JobSource) -> str:
    """Return the state of the files of a source; empty if the source has no files.

    The state of an unreadable source differs from every other state.
    """
    try:
        files = SOURCE_READERS[source.kind].files(source)
        return digest([file_state(file) for file in files]) if files else ""
    except SfrError:
        return UNREADABLE


def inspect_file(path: Path) -> SourceFacts:
    """Return the facts of a file for a plan; raise InputError if the file cannot be read."""
    from sfr_loc_map.io.registry import open_source  # slow import, not needed by a resumed suite

    source = open_source(path)
    pairs, nav_pairs = (0 if part is None else len(part) for part in (source.loc, source.nav))
    return SourceFacts(sha256=files_hash(path), pairs=pairs, nav_pairs=nav_pairs, trace=trace_of_source(source))


def scenario_settings(scenario: Path) -> dict[str, object]:
    """Return all settings of a scenario by dotted name. `simulated_source` replaces the seed, which is 0 here."""
    return flatten(build(SimulationConfig, load_yaml(scenario) | {"seed": 0}, origin=str(scenario)))


def changed_scenario(scenario: Path, changes: Mapping[str, object], origin: str) -> dict[str, object]:
    """Return all settings of a scenario with changes, by dotted name; ConfigError if a change is invalid."""
    return flatten(build(SimulationConfig, {**scenario_settings(scenario), **changes}, origin=origin))


def simulated_source(scenario: Path, settings: Mapping[str, object], seed: int, origin: str) -> JobSource:
    """Return the drive of one seed of a scenario; raise ConfigError if the settings are invalid."""
    complete = flatten(build(SimulationConfig, {**settings, "seed": seed}, origin=origin))
    return JobSource(
        name=f"{scenario.stem}-{seed}",
        kind=SourceKind.SIMULATED,
        path=str(scenario),
        settings=complete,
        sha256=digest(complete),
        seed=seed,
    )
