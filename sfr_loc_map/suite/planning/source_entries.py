"""Finds the sources that the entries of a suite's file state, and gives them unique names. No data are read."""

from __future__ import annotations

import glob
import os
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from msgspec.structs import replace

from sfr_loc_map.configuration.parameters import build, flatten
from sfr_loc_map.configuration.yaml_file import load_yaml
from sfr_loc_map.errors import ConfigError, InputError, naming_key
from sfr_loc_map.simulation.config import SimulationConfig
from sfr_loc_map.suite.jobs.digests import digest
from sfr_loc_map.suite.jobs.source_cache import expand, last_part
from sfr_loc_map.suite.jobs.sources import Simulation, StatedFile, StatedSource

# ---- entries


def sources_of_entry(entry: object, folder: Path, origin: str) -> Iterator[StatedSource]:
    """Yield the sources of an entry of `sources` in a suite's file.

    Paths are relative to `folder`, and errors name `origin`. ConfigError if the entry is invalid. InputError if nothing
    matches the entry, or if a server does not answer.
    """
    match entry:
        case str() if "://" in entry:
            yield from _remote_files(entry)
        case str() if entry:
            yield from _local_files(entry, folder)
        case {"estimate": str(estimate), "truth": str(truth), **others} if not others:
            path = str(folder / estimate)
            yield StatedFile(name=last_part(path), location=path, truth=str(folder / truth))
        case {"simulate": str(scenario), **others}:
            yield from _simulations(scenario, folder, others, origin)
        case _:
            raise ConfigError(
                f"{origin}: a path, a URL, 'simulate: SCENARIO', or 'estimate: EST' with 'truth: TRUTH' is required"
            )


def _remote_files(url: str) -> Iterator[StatedFile]:
    """Yield a source for each match of a URL on the server."""
    urls = expand(url)
    if not urls:
        raise InputError(f"source '{url}': no match; give an existing URL or glob")
    for match in urls:
        yield StatedFile(name=last_part(match), location=match)


def _local_files(entry: str, folder: Path) -> Iterator[StatedFile]:
    """Yield a source for each match of a glob; a path that exists is not a glob, even if its name has brackets."""
    named = str(folder / entry)
    pattern = str(Path(glob.escape(str(folder))) / entry)  # the name of the folder is not a pattern
    paths = [named] if os.path.exists(named) else sorted(glob.glob(pattern, recursive=True))
    if not paths:
        raise InputError(f"source '{entry}': no match in '{folder}'; give an existing path or glob")
    for path in paths:
        yield StatedFile(name=last_part(path), location=path)


def _simulations(stated_scenario: str, folder: Path, others: Mapping[Any, Any], origin: str) -> Iterator[Simulation]:
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
        yield simulation_of(scenario, settings, seed, f"{origin}: 'seeds'")


def scenario_settings(scenario: Path) -> dict[str, object]:
    """Return all settings of a scenario by dotted name. `simulation_of` replaces the seed, which is 0 here."""
    return flatten(build(SimulationConfig, load_yaml(scenario) | {"seed": 0}, origin=str(scenario)))


def changed_scenario(scenario: Path, changes: Mapping[str, object], origin: str) -> dict[str, object]:
    """Return all settings of a scenario with changes, by dotted name; ConfigError if a change is invalid."""
    return flatten(build(SimulationConfig, {**scenario_settings(scenario), **changes}, origin=origin))


def simulation_of(scenario: Path, settings: Mapping[str, object], seed: int, origin: str) -> Simulation:
    """Return the simulation of one seed of a scenario; raise ConfigError if the settings are invalid."""
    complete = flatten(build(SimulationConfig, {**settings, "seed": seed}, origin=origin))
    sha256 = digest(complete)
    return Simulation(
        name=f"{scenario.stem}-{seed}", path=str(scenario), sha256=sha256, drive=sha256, settings=complete, seed=seed
    )


# ---- names


def with_unique_names(sources: Sequence[StatedSource]) -> list[StatedSource]:
    """Return the sources with unique names.

    Simulations with equal names and different settings are named by the folder of their scenario, then by the settings
    that differ. Other sources with equal names are named by the shortest ends of their locations that differ, and
    estimates with several ground truths also by the path of the ground truth. Equal sources keep one name.
    """
    named = [*sources]
    for name_of in (_name_with_folder, _name_with_settings, _name_by_location, _name_with_truth):
        named = _renamed(named, name_of)
    return named


def _renamed(
    sources: Sequence[StatedSource], name_of: Callable[[StatedSource, Sequence[StatedSource]], str]
) -> list[StatedSource]:
    """Return the sources with the names that `name_of` returns for each source and all sources of its name."""
    namesakes: dict[str, list[StatedSource]] = {}
    for source in sources:
        namesakes.setdefault(source.name, []).append(source)
    return [replace(source, name=name_of(source, namesakes[source.name])) for source in sources]


def _name_with_folder(source: StatedSource, namesakes: Sequence[StatedSource]) -> str:
    others = _simulations_like(source, namesakes)
    has_one_scenario = len({other.path for other in others}) < 2
    return source.name if has_one_scenario else f"{Path(source.location).parent.name}/{source.name}"


def _name_with_settings(source: StatedSource, namesakes: Sequence[StatedSource]) -> str:
    others = _simulations_like(source, namesakes)
    if not isinstance(source, Simulation) or not others:
        return source.name
    settings = source.settings  # each simulation has all settings of a scenario
    differing = [name for name in settings if len({str(other.settings[name]) for other in others}) > 1]
    return f"{source.name} ({', '.join(f'{name}={settings[name]}' for name in differing)})"


def _simulations_like(source: StatedSource, namesakes: Sequence[StatedSource]) -> list[Simulation]:
    """Return the simulations with the name of a simulation if their settings differ; otherwise nothing."""
    if not isinstance(source, Simulation):
        return []
    simulations = [other for other in namesakes if isinstance(other, Simulation)]
    return simulations if len({other.sha256 for other in simulations}) > 1 else []


def _name_by_location(source: StatedSource, namesakes: Sequence[StatedSource]) -> str:
    """Return the end of the location of a file that has namesakes elsewhere.

    The names do not include folders that all these files have in common, so that the results of two methods in two
    folders have the same names.
    """
    locations = {other.location for other in namesakes}
    if isinstance(source, Simulation) or len(locations) == 1:
        return source.name
    return _differing_end(source.location, locations)


def _differing_end(path: str, paths: Collection[str]) -> str:
    """Return the end of a path with the smallest number of parts for which the ends of all paths differ."""
    most = max(len(Path(other).parts) for other in paths)
    for count in range(1, most):
        ends = {Path(other).parts[-count:] for other in paths}
        if len(ends) == len(paths):
            return "/".join(Path(path).parts[-count:])
    return path


def _name_with_truth(source: StatedSource, namesakes: Sequence[StatedSource]) -> str:
    truths = {other.truth for other in namesakes if isinstance(other, StatedFile)}
    if not isinstance(source, StatedFile) or not source.truth or len(truths) == 1:
        return source.name
    return f"{source.name} (truth={source.truth})"
