"""Reads the file of a suite (docs/suites.md) in three steps: `parse`, `check` and `discover`."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from msgspec import Struct
from msgspec.structs import replace

from sfr_loc_map.configuration.parameters import build, flatten, param, suggestion
from sfr_loc_map.configuration.yaml_file import load_yaml
from sfr_loc_map.errors import ConfigError, InputError, naming_key
from sfr_loc_map.faults.kinds import parse_fault
from sfr_loc_map.message_text import alternatives
from sfr_loc_map.metrics.conditions import Condition
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.judging.limits_file import parse_limits
from sfr_loc_map.metrics.score.limits import Limits
from sfr_loc_map.suite.jobs.configurations import Configuration, read_configurations
from sfr_loc_map.suite.jobs.job import JobTask
from sfr_loc_map.suite.jobs.sources import Simulation, StatedSource
from sfr_loc_map.suite.planning.source_entries import simulation_of, sources_of_entry, with_unique_names
from sfr_loc_map.suite.planning.variants import ErrorSource, parse_budget, variants_of

LISTS = ("sources", "perturb", "tasks", "conditions")
NOT_EMPTY = ("tasks", "conditions")  #: Lists whose defaults apply if the list is missing, but not if it is empty.
OTHERS = ("budget", "configurations", "limits")


@dataclass(frozen=True, slots=True)
class SuiteSettings:
    """Scalar settings of a suite."""

    spacing: int = param(10, unit="frames", doc="Frames between the starts of sub-trajectories.", low=1, high=10**6)
    rebase: str = param(
        "pose",
        doc="How errors from before the start of a sub-trajectory are removed, as in `sfr score`.",
        choices=("pose", "displacement", "position"),
    )
    partial: bool = param(False, doc="Judge an incomplete estimate as if it were complete, and report this.")
    nominal: bool = param(True, doc="Run each source also without the faults of `perturb`.")
    stop_when_decided: bool = param(
        False, doc="Stop when sequential tests (`good` of a limit) have decided all limits."
    )
    start: str = param("truth", doc="First pose of a drive.", choices=("identity", "truth"))
    repeats: int = param(1, doc="Number of times that each job is run.", low=1, high=1000)
    seed: int = param(0, doc="Seed that selects the pairs that a fault affects.", low=0, high=2**31 - 1)
    threads: int = param(1, doc="Number of threads of a job.", low=1, high=256)
    memory_mb: int = param(
        4000, unit="MB", doc="Resident memory above which the process of a job is killed.", low=500, high=10**6
    )
    timeout_s: float = param(
        3600.0, unit="s", doc="Time after which a job is killed. A job is tried three times.", low=0.1, high=1e7
    )
    wait_s: float = param(300.0, unit="s", doc="Maximum time without a usable worker.", low=0.1, high=1e7)


class Refusal(Struct, frozen=True, rename={"name": "path"}):
    """A source that cannot be read, lacks data for a task, or has a result but no job any more, and the reason."""

    #: Name of the source, or text of an entry of `sources` without a source. Its key in `suite.json`: `path`.
    name: str
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class SuiteSpecification:
    """Content of the file of a suite, with the sources that its entries state."""

    path: Path  #: File of the suite.
    entries: Sequence[object]  #: Entries of `sources`.
    perturb: tuple[str, ...]  #: Injected faults.
    budget: tuple[ErrorSource, ...]  #: Sources of error of an error budget; empty without a budget.
    configurations: Mapping[str, Configuration]
    tasks: tuple[JobTask, ...]  #: Tasks in the file; empty if it states none.
    conditions: tuple[str, ...]
    stated_limits: Mapping[str, Any]  #: The limits as stated in their file; empty if there are none.
    limits: Limits | None  #: None if there are none.
    limits_file: Path | None  #: File of the limits; None if they are in the suite's file or missing.
    settings: SuiteSettings  #: Scalar settings.
    sources: tuple[StatedSource, ...] = ()  #: One for each match and each seed of the entries, with unique names.
    refusals: tuple[Refusal, ...] = ()  #: Entries without a match, or with a server that does not answer.

    @property
    def files(self) -> tuple[Path, ...]:
        """The file of the suite, and the file of its limits if there is one."""
        return (self.path,) if self.limits_file is None else (self.path, self.limits_file)

    @property
    def faults(self) -> tuple[str, ...]:
        """Faults of the jobs; first an empty text, if the sources are also run without faults."""
        return ("", *self.perturb) if self.settings.nominal else self.perturb

    @property
    def requested_tasks(self) -> tuple[JobTask, ...]:
        """Tasks for which each source must have data; empty if the sources are run with the tasks that they allow."""
        return (JobTask.LOCALISE,) if self.budget else self.tasks

    @property
    def scoring(self) -> TrajectoryScoreConfig:
        """Settings of the scores, including conditions that only the limits name."""
        settings = self.settings
        of_limits = () if self.limits is None else self.limits.conditions
        conditions = tuple(dict.fromkeys((*self.conditions, *of_limits)))
        return TrajectoryScoreConfig(conditions, settings.spacing, settings.rebase, settings.partial)

    @property
    def kept_errors(self) -> tuple[tuple[str, str], ...]:
        """Figures and conditions with a limited tolerance bound, which requires the errors of all drives."""
        return () if self.limits is None else tuple(sorted(self.limits.bounded_figures))


def load_specification(path: Path | str) -> SuiteSpecification:
    """Read the file of a suite, and find its sources. The data of the sources are not read.

    Paths in the file are relative to its folder. ConfigError if the file is missing or invalid. InputError if no
    source is found, or if a file of a method cannot be read.
    """
    specification = parse(Path(path))
    check(specification)
    sources, refusals = discover(specification)
    return dataclasses.replace(specification, sources=tuple(sources), refusals=tuple(refusals))


# ---- parse: each value by itself


def parse(path: Path) -> SuiteSpecification:
    """Return the content of the file of a suite, without sources; ConfigError if a key or a value is invalid."""
    content = load_yaml(path)
    check_keys(content, (*LISTS, *OTHERS, *flatten(SuiteSettings())), path)
    if empty := [name for name in NOT_EMPTY if content.get(name) == []]:
        raise ConfigError(f"{path}: '{empty[0]}' is empty: give at least one entry, or omit '{empty[0]}'")
    lists = {name: _list_in(content, name, path) for name in LISTS}
    budget = parse_budget(content.pop("budget"), str(path)) if "budget" in content else ()
    configurations = content.pop("configurations", None)
    has_limits = "limits" in content
    limits_value = content.pop("limits", None)
    stated_limits = _stated_limits(limits_value, path) if has_limits else {}
    settings = build(SuiteSettings, content, origin=str(path))  # of the keys that are left
    return SuiteSpecification(
        path=path,
        entries=lists["sources"],
        perturb=_faults(lists["perturb"], path),
        budget=budget,
        configurations=read_configurations(configurations, path),
        tasks=_tasks(lists["tasks"], path),
        conditions=_conditions(lists["conditions"] or ["distance=5"], path),
        stated_limits=stated_limits,
        limits=parse_limits(stated_limits, f"{path}: limits") if has_limits else None,
        limits_file=path.parent / limits_value if isinstance(limits_value, str) else None,
        settings=settings,
    )


def check_keys(content: Mapping[str, Any], known: Sequence[str], path: Path) -> None:
    """Raise ConfigError if the file of a suite or of a search has an unknown key."""
    if unknown := [name for name in content if name not in known]:
        raise ConfigError(f"{path}: unknown key '{unknown[0]}'{suggestion(str(unknown[0]), known)}")


def _list_in(content: dict[str, Any], name: str, path: Path) -> list[Any]:
    """Remove a list from the content of a file and return the list, which is empty if the file has no value for it."""
    value = content.pop(name, None)
    if value is None:
        return []
    if not isinstance(value, list):
        raise ConfigError(f"{path}: '{name}' is {value!r:.40}: a list is required")
    return value


def _faults(texts: Sequence[object], path: Path) -> tuple[str, ...]:
    """Return the faults of `perturb`, each one or several that are joined by `+`."""
    faults = tuple(map(str, texts))
    with naming_key(f"{path}: 'perturb'"):
        for joined in faults:
            for fault in joined.split("+"):
                parse_fault(fault)
    return faults


def _tasks(names: Sequence[object], path: Path) -> tuple[JobTask, ...]:
    if unknown := [name for name in names if name not in list(JobTask)]:
        raise ConfigError(f"{path}: 'tasks' has {unknown[0]!r:.40}: {alternatives(JobTask)} is required")
    return tuple(JobTask(str(name)) for name in names)


def _conditions(texts: Sequence[object], path: Path) -> tuple[str, ...]:
    with naming_key(f"{path}: 'conditions'"):
        return tuple(Condition.parse(str(text)).setting for text in texts)


def _stated_limits(value: object, path: Path) -> Mapping[str, Any]:
    """Return the limits in a suite's file, or in the limits file that it names."""
    content = load_yaml(path.parent / value) if isinstance(value, str) else value
    if not isinstance(content, Mapping):
        raise ConfigError(
            f"{path}: 'limits' is {value!r:.40}: the name of a limits file, or limits as NAME: VALUE, is required"
        )
    return dict(content)


# ---- check: values that exclude or require each other


def check(specification: SuiteSpecification) -> None:
    """Raise ConfigError if values of a suite's file contradict each other, or if a setting has no effect."""
    path = specification.path
    settings = specification.settings
    limits = specification.limits
    if not specification.entries:
        raise ConfigError(f"{path}: 'sources' is missing or empty: give paths, globs or simulations")
    if not settings.nominal and not specification.perturb:
        raise ConfigError(f"{path}: with 'nominal: false' at least one fault in 'perturb' is required")
    is_sequential = [] if limits is None else [limit.good is not None for limit in limits.limits]
    if settings.stop_when_decided and not (is_sequential and all(is_sequential)):
        raise ConfigError(f"{path}: 'stop_when_decided' has no effect unless every limit has 'good': remove it")
    if not specification.budget:
        return
    if limits is not None or specification.perturb or specification.tasks not in ((), (JobTask.LOCALISE,)):
        raise ConfigError(
            f"{path}: 'budget' cannot be combined with 'limits' or 'perturb', and requires 'tasks: [localise]'"
        )
    if settings.repeats > 1:
        raise ConfigError(f"{path}: 'repeats' has no effect in a suite with 'budget': remove it, and give more seeds")


# ---- discover: the sources that the entries state


def discover(specification: SuiteSpecification) -> tuple[list[StatedSource], list[Refusal]]:
    """Return the sources of the entries, and the entries that cannot be read; InputError if no entry can be read.

    With a budget, each simulation is there with each combination of the sources of error that the budget requires.
    """
    folder = specification.path.absolute().parent
    sources: list[StatedSource] = []
    refusals: list[Refusal] = []
    for number, entry in enumerate(specification.entries, 1):
        try:
            sources += list(sources_of_entry(entry, folder, f"{specification.path}: source {number}"))
        except InputError as error:
            refusals.append(Refusal(str(entry), str(error)))
    if not sources:
        raise InputError(refusals[0].reason)
    named = with_unique_names(sources)
    if specification.budget:
        named = [variant for source in named for variant in _variants(source, specification)]
    return named, refusals


def _variants(source: StatedSource, specification: SuiteSpecification) -> Iterator[Simulation]:
    """Yield a simulation with each combination of the sources of error that a budget requires."""
    origin = f"{specification.path}: 'budget'"
    if not isinstance(source, Simulation):
        raise ConfigError(f"{origin} requires sources 'simulate: SCENARIO', but '{source.name}' is not simulated")
    names: dict[tuple[str, str], str] = {}
    for variant in variants_of(specification.budget):
        settings = variant.settings(source.settings)
        simulation = simulation_of(Path(source.path), settings, source.seed, origin)
        faults = variant.faults(source.seed)
        equal = names.setdefault((simulation.sha256, faults), variant.name)
        if equal != variant.name:
            raise ConfigError(
                f"{origin}: the variants '{equal}' and '{variant.name}' of '{source.name}' are equal; each source of "
                "error must change the scenario"
            )
        yield replace(simulation, name=source.name, variant=variant.name, faults=faults)
