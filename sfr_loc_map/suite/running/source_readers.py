"""Reads the sources of a suite: the entries of its file, their data for the plan, and the paths that jobs read."""

from __future__ import annotations

import glob
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

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
from sfr_loc_map.suite.running.job import JobTask, digest, tasks_for
from sfr_loc_map.suite.running.source_cache import expand, fetch, rendered
from sfr_loc_map.suite.running.source_names import last_part
from sfr_loc_map.suite.running.sources import (
    Estimate,
    PlannedSource,
    Recording,
    Simulation,
    StatedEstimate,
    StatedRecording,
    StatedRemote,
    StatedSimulation,
    StatedSource,
)

UNREADABLE = "unreadable"  #: State of files of which one cannot be read.


# ---- entries of the suite's file


def read_entry(entry: object, folder: Path, origin: str) -> Iterator[StatedSource]:
    """Yield the sources of an entry of `sources` in a suite's file.

    Paths are relative to `folder`, and errors name `origin`. ConfigError if the entry is invalid. InputError if nothing
    matches the entry, or if a server does not answer.
    """
    match entry:
        case str() if "://" in entry:
            yield from _stated_remotes(entry)
        case str() if entry:
            yield from _stated_recordings(entry, folder)
        case {"estimate": str(estimate), "truth": str(truth), **others} if not others:
            path = str(folder / estimate)
            yield StatedEstimate(name=last_part(path), location=path, truth=str(folder / truth))
        case {"simulate": str(scenario), **others}:
            yield from _stated_simulations(scenario, folder, others, origin)
        case _:
            raise ConfigError(
                f"{origin}: a path, a URL, 'simulate: SCENARIO', or 'estimate: EST' with 'truth: TRUTH' is required"
            )


def _stated_remotes(url: str) -> Iterator[StatedRemote]:
    """Yield a source for each match of a URL on the server."""
    urls = expand(url)
    if not urls:
        raise InputError(f"source '{url}': no match; give an existing URL or glob")
    for match in urls:
        yield StatedRemote(name=last_part(match), location=match)


def _stated_recordings(entry: str, folder: Path) -> Iterator[StatedRecording]:
    """Yield a source for each match of a glob; a path that exists is no glob, even if its name has brackets."""
    named = str(folder / entry)
    pattern = str(Path(glob.escape(str(folder))) / entry)  # the name of the folder is no pattern
    paths = [named] if os.path.exists(named) else sorted(glob.glob(pattern, recursive=True))
    if not paths:
        raise InputError(f"source '{entry}': no match in '{folder}'; give an existing path or glob")
    for path in paths:
        yield StatedRecording(name=last_part(path), location=path)


def _stated_simulations(
    stated_scenario: str, folder: Path, others: Mapping[Any, Any], origin: str
) -> Iterator[StatedSimulation]:
    """Yield a simulation of a scenario for each seed; `others` are the other keys of the entry."""
    scenario = folder / stated_scenario
    seeds, stated = others.get("seeds", [0]), others.get("set", {})
    is_whole = isinstance(seeds, list) and all(type(seed) is int for seed in seeds)
    if set(others) - {"seeds", "set"} or not is_whole or not seeds or not isinstance(stated, Mapping):
        raise ConfigError(
            f"{origin}: 'simulate' accepts 'seeds' (a list of whole numbers) and 'set' (settings as NAME: VALUE)"
        )
    with naming_key(f"{origin}: 'set'"):
        changes = flatten(stated)
    if "seed" in changes:
        raise ConfigError(f"{origin}: 'seed' in 'set' has no effect: give 'seeds'")
    if not scenario.exists():
        raise InputError(f"source 'simulate: {stated_scenario}': '{scenario}' is missing; give a scenario file")
    settings = changed_scenario(scenario, changes, f"{origin}: 'set'")
    for seed in seeds:
        yield stated_simulation(scenario, settings, seed, f"{origin}: 'seeds'")


def scenario_settings(scenario: Path) -> dict[str, object]:
    """Return all settings of a scenario by dotted name. `stated_simulation` replaces the seed, which is 0 here."""
    return flatten(build(SimulationConfig, load_yaml(scenario) | {"seed": 0}, origin=str(scenario)))


def changed_scenario(scenario: Path, changes: Mapping[str, object], origin: str) -> dict[str, object]:
    """Return all settings of a scenario with changes, by dotted name; ConfigError if a change is invalid."""
    return flatten(build(SimulationConfig, {**scenario_settings(scenario), **changes}, origin=origin))


def stated_simulation(scenario: Path, settings: Mapping[str, object], seed: int, origin: str) -> StatedSimulation:
    """Return the simulation of one seed of a scenario; raise ConfigError if the settings are invalid."""
    complete = flatten(build(SimulationConfig, {**settings, "seed": seed}, origin=origin))
    return StatedSimulation(
        name=f"{scenario.stem}-{seed}", location=str(scenario), settings=complete, sha256=digest(complete), seed=seed
    )


# ---- data of the sources, for the plan


@dataclass(frozen=True, slots=True, kw_only=True)
class SourceFacts:
    """Facts of a recording for a plan: hash of the content, numbers of localisation and mapping pairs."""

    sha256: str
    pairs: int
    nav_pairs: int
    trace: DriveTrace = field(default_factory=DriveTrace)  #: Features that copies of the drive share.


class InspectedSource(NamedTuple):
    """A source on this host, its tasks and its features. Its drive is that of the source alone."""

    source: PlannedSource
    possible: tuple[JobTask, ...]  #: Tasks for which the source has data.
    trace: DriveTrace = DriveTrace()  #: Features that copies of the drive share.


def inspected(stated: StatedSource, facts_of: Callable[[Path], SourceFacts], cache: Path) -> InspectedSource:
    """Return a source with the hashes of its data; `facts_of` inspects a recording.

    A remote recording is fetched to `cache`. InputError if the data cannot be read.
    """
    match stated:
        case StatedRecording():
            return _inspected_recording(stated, Path(stated.location), "", facts_of)
        case StatedRemote():
            path = fetch(stated.location, cache).absolute()
            return _inspected_recording(stated, path, stated.location, facts_of)
        case StatedEstimate():
            return _inspected_estimate(stated)
        case StatedSimulation():
            config = build(SimulationConfig, stated.settings)
            possible = tasks_for(has_drive=config.drive.enabled, has_panorama=config.panorama.enabled)
            return InspectedSource(Simulation.of(stated), possible)


def _inspected_recording(
    stated: StatedRecording | StatedRemote, path: Path, url: str, facts_of: Callable[[Path], SourceFacts]
) -> InspectedSource:
    state = state_of(files_of_source, path)  # before the files are hashed, so that a later change is detected
    facts = facts_of(path)
    recording = Recording(
        name=stated.name,
        entry=stated.entry,
        path=str(path),
        sha256=facts.sha256,
        drive=facts.sha256,
        state=state,
        url=url,
    )
    possible = tasks_for(has_drive=facts.pairs > 0, has_panorama=facts.nav_pairs > 0)
    return InspectedSource(recording, possible, facts.trace)


def _inspected_estimate(stated: StatedEstimate) -> InspectedSource:
    path, truth = Path(stated.location), Path(stated.truth)
    state = state_of(files_of_estimate, path, truth)  # before the files are hashed, as for a recording
    truth_sha256 = files_hash(truth)
    estimate = Estimate(
        name=stated.name,
        entry=stated.entry,
        path=stated.location,
        sha256=estimate_hash(path, truth),
        drive=truth_sha256,
        truth=stated.truth,
        truth_sha256=truth_sha256,
        input_sha256=input_hashes(path, truth),
        state=state,
    )
    return InspectedSource(estimate, (JobTask.SCORE,), trace_of_estimate(path, truth))


def inspect_file(path: Path) -> SourceFacts:
    """Return the facts of a recording for a plan; raise InputError if the recording cannot be read."""
    from sfr_loc_map.io.registry import open_source  # slow import, not needed by a resumed suite

    source = open_source(path)
    pairs, nav_pairs = (0 if part is None else len(part) for part in (source.loc, source.nav))
    return SourceFacts(sha256=files_hash(path), pairs=pairs, nav_pairs=nav_pairs, trace=trace_of_source(source))


# ---- files of the sources, for jobs


def local_path(source: PlannedSource, cache: Path) -> Path:
    """Return the path at which a job reads a source; a simulation is rendered to `cache`."""
    return rendered(source, cache) if isinstance(source, Simulation) else Path(source.path)


def has_changed(source: PlannedSource) -> bool:
    """Return whether the files of a source are not those that the plan hashed; a simulation has no files."""
    match source:
        case Recording():
            return state_of(files_of_source, Path(source.path)) != source.state
        case Estimate():
            return state_of(files_of_estimate, Path(source.path), Path(source.truth)) != source.state
        case Simulation():
            return False


def state_of(files_of: Callable[..., Sequence[Path]], *paths: Path) -> str:
    """Return the state of the files that `files_of` returns for paths; `UNREADABLE` if one of them cannot be read."""
    try:
        return digest([file_state(file) for file in files_of(*paths)])
    except SfrError:
        return UNREADABLE
