"""Names of sources. Each source of a suite has its own name; the variants of an error budget share one name."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from pathlib import Path

from sfr_loc_map.suite.running.sources import StatedEstimate, StatedSimulation, StatedSource


def with_unique_names(sources: Sequence[StatedSource]) -> list[StatedSource]:
    """Return the sources with unique names.

    Simulations with equal names and different settings are named by the folder of their scenario, then by the settings
    that differ. Other sources with equal names are named by the shortest ends of their locations that differ, and
    estimates with several ground truths also by the path of the ground truth.
    """
    named = _with_simulations_renamed(sources, _name_with_folder)
    named = _with_simulations_renamed(named, _name_with_settings)
    named = _with_files_renamed(named)
    return _with_truths_named(named)


def _with_simulations_renamed(
    sources: Sequence[StatedSource], name_of: Callable[[StatedSimulation, Sequence[StatedSimulation]], str]
) -> list[StatedSource]:
    """Return the sources; simulations that share a name, but not the settings, are named by `name_of`."""
    of_name: dict[str, list[StatedSimulation]] = {}
    for source in sources:
        if isinstance(source, StatedSimulation):
            of_name.setdefault(source.name, []).append(source)
    renamed: list[StatedSource] = []
    for source in sources:
        if isinstance(source, StatedSimulation):
            equal = of_name[source.name]
            if len({other.sha256 for other in equal}) > 1:
                renamed.append(replace(source, name=name_of(source, equal)))
                continue
        renamed.append(source)
    return renamed


def _name_with_folder(source: StatedSimulation, equal: Sequence[StatedSimulation]) -> str:
    has_one_scenario = len({other.location for other in equal}) == 1
    return source.name if has_one_scenario else f"{Path(source.location).parent.name}/{source.name}"


def _name_with_settings(source: StatedSimulation, equal: Sequence[StatedSimulation]) -> str:
    settings = source.settings  # each simulation has all settings of a scenario
    differing = [name for name in settings if len({str(other.settings[name]) for other in equal}) > 1]
    return f"{source.name} ({', '.join(f'{name}={settings[name]}' for name in differing)})"


def _with_files_renamed(sources: Sequence[StatedSource]) -> list[StatedSource]:
    """Return the sources; files of equal name are named by the shortest ends of their locations that differ.

    The names do not include folders that all these files have in common, so that the results of two methods in two
    folders have the same names.
    """
    locations: dict[str, set[str]] = {}
    for source in sources:
        locations.setdefault(source.name, set()).add(source.location)
    renamed: list[StatedSource] = []
    for source in sources:
        equal = locations[source.name]
        if isinstance(source, StatedSimulation) or len(equal) == 1:
            renamed.append(source)
            continue
        renamed.append(replace(source, name=_differing_end(source.location, equal)))
    return renamed


def _differing_end(path: str, paths: Collection[str]) -> str:
    """Return the end of a path with the smallest number of parts for which the ends of all paths differ."""
    most = max(len(Path(other).parts) for other in paths)
    for count in range(1, most):
        ends = {Path(other).parts[-count:] for other in paths}
        if len(ends) == len(paths):
            return "/".join(Path(path).parts[-count:])
    return path


def _with_truths_named(sources: Sequence[StatedSource]) -> list[StatedSource]:
    """Return the sources; an estimate that occurs with several ground truths is also named by the ground truth."""
    truths: dict[str, set[str]] = {}
    for source in sources:
        truth = source.truth if isinstance(source, StatedEstimate) else ""
        truths.setdefault(source.name, set()).add(truth)
    return [
        replace(source, name=f"{source.name} (truth={source.truth})")
        if isinstance(source, StatedEstimate) and len(truths[source.name]) > 1
        else source
        for source in sources
    ]


def last_part(path: str) -> str:
    """Return the name of a file or folder in a path or a URL, without the query of the URL."""
    location = path.partition("?")[0] if "://" in path else path
    return location.rstrip("/").rpartition("/")[2]
