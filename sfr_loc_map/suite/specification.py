"""The file of a suite: which sources, faults, configurations and tasks.

sources:                                  # paths and globs, relative to this file
  - data/*.mcap
  - s3://bucket/drives/*.mcap               # what fsspec reads; tasks must be given then
  - {url: https://host/drive.mcap, sha256: 0a1b...}   # the content is checked
  - {simulate: config/simulation/rocky.yaml, seeds: [1, 2], set: {drive.pairs: 60}}
  - {estimate: other/est.tum, truth: data/drive}      # of the task `score`
perturb: ["black:share=0.1", "blurred+noisy"]         # each as well as the source without faults
configurations: {default: {}, few: {localisation: {max_features: 400}}, other: {localisation: {method: opencv}}}
tasks: [localise, map]                    # localise, map, replay; score for estimates. Default: what a source has
conditions: [distance=5]
spacing: 10
rebase: pose
start: truth
limits: limits.yaml                       # a file, or the limits themselves
repeats: 1
timing: false                             # true: one job at a time
threads: 1
memory_mb: 4000
timeout_s: 3600
cache_mb: 20000                           # of copies of remote sources, at the start of a run
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sfr_loc_map.config import build, flatten, load_yaml, param
from sfr_loc_map.errors import ConfigError
from sfr_loc_map.inputs import Task, read_text
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.methods.registry import LIBRARY_PREFIX, OURS, Method, find_method
from sfr_loc_map.metrics.config import Condition
from sfr_loc_map.metrics.limits import parse_limits
from sfr_loc_map.simulation.faults import parse_fault
from sfr_loc_map.suite.job import JobKind, Scoring
from sfr_loc_map.suite.sources import is_remote

SECTIONS = {"localisation": LocalisationConfig, "mapping": MappingConfig}
METHOD_KEYS = ("method", "method_config", "method_sha256")
"""Keys beside the parameters of a part: the method, the file with its configuration; the last is added here."""
METHOD_TASKS = {"localisation": Task.LOCALISATION, "mapping": Task.MAPPING}
LISTS = ("sources", "perturb", "tasks", "conditions")


@dataclass(frozen=True, slots=True)
class SuiteSettings:
    """Single values of a suite."""

    spacing: int = param(
        10, unit="frames", doc="Frames from one start of a sub-trajectory to the next.", low=1, high=10**6
    )
    rebase: str = param("pose", doc="What is taken from the estimate at a start.", choices=("pose", "position"))
    start: str = param("truth", doc="First pose of a drive.", choices=("identity", "truth"))
    repeats: int = param(1, doc="Runs of each task.", low=1, high=1000)
    seed: int = param(0, doc="Seed of which pairs a fault affects.", low=0, high=2**31 - 1)
    timing: bool = param(False, doc="Run one task at a time, so that its times count.")
    threads: int = param(1, doc="Threads of a task.", low=1, high=256)
    memory_mb: int = param(
        4000, unit="MB", doc="Resident memory at which the process of a task is ended.", low=500, high=10**6
    )
    timeout_s: float = param(3600.0, unit="s", doc="Time after which a task is ended.", low=0.1, high=1e7)
    cache_mb: int = param(
        20000, unit="MB", doc="Size of all copies of remote sources at the start of a run.", low=1, high=10**9
    )


@dataclass(frozen=True, slots=True)
class SourceEntry:
    """One entry of `sources`."""

    path: str  #: Path or glob, URL, scenario, or estimate.
    seeds: tuple[int, ...] | None = None  #: Seeds of a scenario; None where the entry is not a simulation.
    settings: Mapping[str, Any] | None = None  #: Settings of the simulation besides those of the scenario.
    truth: str | None = None  #: Truth of an estimate, or None.
    sha256: str = ""  #: Hash of the content at a URL, empty where it is not known.


@dataclass(frozen=True, slots=True)
class SuiteSpecification:
    """What a suite is made of."""

    path: Path  #: The file.
    sources: tuple[SourceEntry, ...]  #: Entries of the file.
    perturb: tuple[str, ...]  #: Injected faults; the source without faults comes first, as an empty text.
    configurations: Mapping[str, Mapping[str, object]]  #: Parameters by dotted name, by the configuration's name.
    tasks: tuple[JobKind, ...] | None  #: What is done; None for what each source has.
    conditions: tuple[str, ...]  #: Ends of sub-trajectories.
    limits: Mapping[str, Any]  #: Limits, empty for none.
    settings: SuiteSettings  #: Single values.

    @property
    def scoring(self) -> Scoring:
        """How each task is scored; conditions that only the limits name are scored as well."""
        named = [Condition.parse(text) for text in self.conditions]
        if self.limits:
            named += parse_limits(self.limits, "limits").conditions
        conditions = tuple(dict.fromkeys(item.setting for item in named))
        return Scoring(conditions=conditions, spacing=self.settings.spacing, rebase=self.settings.rebase)


def load_specification(path: Path) -> SuiteSpecification:
    """Read a suite's file.

    Raises:
        ConfigError: If it cannot be read, or a key or value is not valid.
    """
    content = load_yaml(path)
    single = flatten(SuiteSettings())
    _check_keys(content, [*LISTS, "configurations", "limits", *single], str(path))
    lists = {name: _list(content.get(name), f"{path}: '{name}'") for name in LISTS}
    if not lists["sources"]:
        raise ConfigError(f"{path}: no 'sources': give paths, globs or simulations")
    tasks = _tasks(lists["tasks"], str(path))
    sources = tuple(_source(entry, f"{path}: source {number}") for number, entry in enumerate(lists["sources"], 1))
    far = [entry.path for entry in sources if is_remote(entry.path)]
    if far and tasks is None:
        raise ConfigError(f"{path}: '{far[0]}' is not read before it is run: give 'tasks', as [localise]")
    return SuiteSpecification(
        path=path,
        sources=sources,
        perturb=("", *map(_fault, lists["perturb"])),
        configurations=_configurations(content.get("configurations"), path),
        tasks=tasks,
        conditions=tuple(Condition.parse(str(text)).setting for text in lists["conditions"]) or ("distance=5",),
        limits=_limits(content.get("limits"), path),
        settings=build(
            SuiteSettings, {key: value for key, value in content.items() if key in single}, origin=str(path)
        ),
    )


def _check_keys(content: Mapping[str, Any], known: Sequence[str], origin: str) -> None:
    for key in content:
        if key not in known:
            close = difflib.get_close_matches(str(key), known, n=1)
            hint = f"did you mean '{close[0]}'?" if close else f"known: {', '.join(known)}"
            raise ConfigError(f"{origin}: unknown key '{key}' ({hint})")


def _fault(text: object) -> str:
    """Return a fault, or several joined by `+`, once each can be read."""
    for part in str(text).split("+"):
        parse_fault(part)
    return str(text)


def _list(value: object, origin: str) -> Sequence[Any]:
    if value is None:
        return ()
    if not isinstance(value, list):
        raise ConfigError(f"{origin} is a {type(value).__name__}: a list is needed")
    return value


def _source(entry: object, origin: str) -> SourceEntry:
    if isinstance(entry, str) and entry:
        return SourceEntry(entry)
    if isinstance(entry, Mapping) and set(entry) == {"estimate", "truth"}:
        return SourceEntry(str(entry["estimate"]), truth=str(entry["truth"]))
    if isinstance(entry, Mapping) and "simulate" in entry:
        return _simulation(entry, origin)
    if isinstance(entry, Mapping) and set(entry) == {"url", "sha256"}:
        return _checked_url(entry, origin)
    raise ConfigError(
        f"{origin}: needs a path or URL, 'simulate: SCENARIO', 'estimate: EST' with 'truth: TRUTH', "
        "or 'url: URL' with 'sha256: HASH'"
    )


def _checked_url(entry: Mapping[str, Any], origin: str) -> SourceEntry:
    url, sha256 = str(entry["url"]), str(entry["sha256"]).lower()
    if not is_remote(url) or not re.fullmatch("[0-9a-f]{64}", sha256):
        raise ConfigError(f"{origin}: 'url' takes a URL as https://..., 'sha256' 64 hexadecimal digits")
    return SourceEntry(url, sha256=sha256)


def _simulation(entry: Mapping[str, Any], origin: str) -> SourceEntry:
    seeds, settings = entry.get("seeds", [0]), entry.get("set", {})
    whole = isinstance(seeds, list) and all(isinstance(seed, int) and not isinstance(seed, bool) for seed in seeds)
    if set(entry) - {"simulate", "seeds", "set"} or not whole or not seeds or not isinstance(settings, Mapping):
        raise ConfigError(f"{origin}: 'simulate' takes 'seeds', a list of whole numbers, and 'set', a mapping")
    return SourceEntry(str(entry["simulate"]), seeds=tuple(seeds), settings=dict(settings))


def _configurations(value: object, path: Path) -> dict[str, dict[str, object]]:
    if value is None:
        return {"default": {}}
    if not isinstance(value, Mapping) or not value:
        raise ConfigError(f"{path}: 'configurations' must map names to parameters, as {{default: {{}}}}")
    return {
        str(name): _parameters(content, f"{path}: configuration '{name}'", path.parent)
        for name, content in value.items()
    }


def _parameters(content: object, origin: str, folder: Path) -> dict[str, object]:
    """Return parameters by dotted name, those with their default value left out."""
    if not isinstance(content, Mapping):
        raise ConfigError(f"{origin}: a mapping with 'localisation' and 'mapping' is needed")
    changed: dict[str, object] = {}
    for section, values in content.items():
        if section not in SECTIONS or not isinstance(values, Mapping):
            raise ConfigError(f"{origin}: '{section}' is not a mapping of parameters; known: {', '.join(SECTIONS)}")
        default = flatten(SECTIONS[section]())
        own = {name: value for name, value in values.items() if name not in METHOD_KEYS}
        given = flatten(build(SECTIONS[section], own, origin=origin))
        changed |= {f"{section}.{name}": value for name, value in given.items() if value != default[name]}
        if METHOD_KEYS[0] in values:
            chosen = _method(values, METHOD_TASKS[section], folder)
            changed |= {f"{section}.{name}": value for name, value in chosen.items()}
    return changed


def _method(values: Mapping[str, object], task: Task, folder: Path) -> dict[str, object]:
    """Return what a job keeps of a method: whole paths, the text of its configuration, the hash of its file."""
    spec, text = str(values["method"]), ""
    place, _, name = spec.rpartition(":")
    if spec.startswith(LIBRARY_PREFIX):
        spec = f"{LIBRARY_PREFIX}{(folder / spec.removeprefix(LIBRARY_PREFIX)).resolve()}"
    elif place.endswith(".py"):
        spec = f"{(folder / place).resolve()}:{name}"
    if "method_config" in values:
        path = folder / str(values["method_config"])
        try:
            text = read_text(path)
        except (OSError, ValueError) as error:
            raise ConfigError(f"'method_config: {path}' cannot be read ({error}): give a text file") from error
    if spec == OURS:
        return {}
    return dict(zip(METHOD_KEYS, (spec, text, find_method(spec, task, text).sha256 or ""), strict=True))


def chosen_method(section: Mapping[str, object], task: Task) -> Method | None:
    """Return the method of a part of a configuration, None where it is ours.

    Raises:
        MethodError: If there is no such method any more.
    """
    if METHOD_KEYS[0] not in section:
        return None
    return find_method(str(section["method"]), task, str(section.get("method_config", "")))


def _tasks(names: Sequence[object], origin: str) -> tuple[JobKind, ...] | None:
    try:
        return tuple(JobKind(str(name)) for name in names) or None
    except ValueError as error:
        raise ConfigError(f"{origin}: 'tasks' may hold {', '.join(JobKind)}: {error}") from error


def _limits(value: object, path: Path) -> Mapping[str, Any]:
    if value is None:
        return {}
    content = load_yaml(path.parent / value) if isinstance(value, str) else value
    if not isinstance(content, Mapping):
        raise ConfigError(f"{path}: 'limits' must be a file or a mapping")
    parse_limits(content, f"{path}: limits")
    return dict(content)
