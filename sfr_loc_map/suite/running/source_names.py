"""Names of sources. Each source of a suite has its own name; the variants of an error budget share one name."""

from __future__ import annotations

import glob
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from pathlib import Path

from sfr_loc_map.suite.running.job import JobSource


def with_unique_names(sources: Sequence[JobSource]) -> list[JobSource]:
    """Return the sources with unique names.

    Simulations with equal names and different settings are named by the folder of their scenario, then by the settings
    that differ. Other sources with equal names are named by the shortest ends of their paths that differ, and estimates
    with several ground truths also by the path of the ground truth.
    """
    named = _with_simulations_renamed(sources, _name_with_folder)
    named = _with_simulations_renamed(named, _name_with_settings)
    named = _with_files_renamed(named)
    return _with_truths_named(named)


def _with_simulations_renamed(
    sources: Sequence[JobSource], name_of: Callable[[JobSource, Sequence[JobSource]], str]
) -> list[JobSource]:
    """Return the sources; simulations that share a name, but not the settings, are named by `name_of`."""
    of_name: dict[str, list[JobSource]] = {}
    for source in sources:
        if source.settings:
            of_name.setdefault(source.name, []).append(source)
    renamed = []
    for source in sources:
        equal = of_name.get(source.name, []) if source.settings else []
        is_shared = len({other.sha256 for other in equal}) > 1
        renamed.append(replace(source, name=name_of(source, equal)) if is_shared else source)
    return renamed


def _name_with_folder(source: JobSource, equal: Sequence[JobSource]) -> str:
    has_one_scenario = len({other.path for other in equal}) == 1
    return source.name if has_one_scenario else f"{Path(source.path).parent.name}/{source.name}"


def _name_with_settings(source: JobSource, equal: Sequence[JobSource]) -> str:
    settings = source.settings  # each simulation has all settings of a scenario
    differing = [name for name in settings if len({str(other.settings[name]) for other in equal}) > 1]
    return f"{source.name} ({', '.join(f'{name}={settings[name]}' for name in differing)})"


def _with_files_renamed(sources: Sequence[JobSource]) -> list[JobSource]:
    """Return the sources; files of equal name are named by the shortest ends of their paths that differ.

    The names do not include folders that all these files have in common, so that the results of two methods in two
    folders have the same names.
    """
    paths: dict[str, set[str]] = {}
    for source in sources:
        paths.setdefault(source.name, set()).add(source.path)
    renamed = []
    for source in sources:
        if source.settings or len(paths[source.name]) == 1:
            renamed.append(source)
            continue
        renamed.append(replace(source, name=_differing_end(source.path, paths[source.name])))
    return renamed


def _differing_end(path: str, paths: Collection[str]) -> str:
    """Return the end of a path with the smallest number of parts for which the ends of all paths differ."""
    most = max(len(Path(other).parts) for other in paths)
    for count in range(1, most):
        ends = {Path(other).parts[-count:] for other in paths}
        if len(ends) == len(paths):
            return "/".join(Path(path).parts[-count:])
    return path


def _with_truths_named(sources: Sequence[JobSource]) -> list[JobSource]:
    """Return the sources; an estimate that occurs with several ground truths is also named by the ground truth."""
    truths: dict[str, set[str]] = {}
    for source in sources:
        truths.setdefault(source.name, set()).add(source.truth)
    return [
        replace(source, name=f"{source.name} (truth={source.truth})")
        if source.truth and len(truths[source.name]) > 1
        else source
        for source in sources
    ]


def last_part(path: str) -> str:
    """Return the name of a file or folder in a path or a URL, without the query of the URL."""
    place = path.partition("?")[0] if "://" in path else path
    return place.rstrip("/").rpartition("/")[2]


def pattern_in(folder: Path, entry: str) -> str:
    """Return the pattern of an entry of `sources`, a path or a glob; the name of the folder is no pattern."""
    return str(Path(glob.escape(str(folder))) / entry)
