"""The file of a suite (docs/suites.md): sources, faults, configurations, tasks, limits and settings."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from msgspec import Struct

from sfr_loc_map.configuration.parameters import build, flatten, param, suggestion
from sfr_loc_map.configuration.yaml_file import load_yaml
from sfr_loc_map.errors import ConfigError, InputError, naming_key
from sfr_loc_map.faults.kinds import parse_fault
from sfr_loc_map.message_text import alternatives
from sfr_loc_map.metrics.conditions import Condition
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.judging.limits_file import parse_limits
from sfr_loc_map.metrics.score.limits import Limits
from sfr_loc_map.suite.running.configurations import Configuration, read_configurations
from sfr_loc_map.suite.running.job import JobTask
from sfr_loc_map.suite.running.source_names import with_unique_names
from sfr_loc_map.suite.running.source_readers import read_entry, stated_simulation
from sfr_loc_map.suite.running.sources import StatedSimulation, StatedSource
from sfr_loc_map.suite.running.variants import ErrorSource, parse_budget, variants_of

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
    order_seed: int = param(
        0,
        doc="Seed of the order in which sequential tests take the drives. 0: order of the hashes of their data.",
        low=0,
        high=2**31 - 1,
    )
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
    entry: int = 0  #: Number of the entry of `sources`, from 1; 0 for a source that is no longer part of the suite.
    source: str = ""  #: Location of the source (`StatedSource.location`); empty for the complete entry.
    task: str = ""  #: Task for which the source has no data; empty for all tasks.

    @property
    def subject(self) -> tuple[int, str, str]:
        """What is refused, by which the refusals of two plans are compared."""
        return self.entry, self.source, self.task


@dataclass(frozen=True, slots=True)
class SuiteSpecification:
    """Content of the file of a suite."""

    path: Path  #: File of the suite.
    sources: tuple[StatedSource, ...]  #: One for each match and each seed, with unique names.
    refusals: tuple[Refusal, ...]  #: Entries without a match, or with a server that does not answer.
    faults: tuple[str, ...]  #: Injected faults; first an empty text, if the source is also run without faults.
    configurations: Mapping[str, Configuration]
    tasks: tuple[JobTask, ...] | None  #: Requested tasks; None: those of `DEFAULT_TASKS` for which a source has data.
    budget: tuple[str, ...]  #: Names of the sources of error of a budget; empty if there is none.
    scoring: TrajectoryScoreConfig  #: Settings of the scores, including conditions that only the limits name.
    limits: Limits | None  #: Limits; None if there are none.
    stated_limits: Mapping[str, Any]  #: The limits as stated in their file; empty if there are none.
    limits_file: Path | None  #: File of the limits; None if they are in the suite's file or missing.
    kept_errors: tuple[tuple[str, str], ...]  #: Figures and conditions with a limited tolerance bound.
    settings: SuiteSettings  #: Scalar settings.

    @property
    def files(self) -> tuple[Path, ...]:
        """The file of the suite, and the file of its limits if there is one."""
        return (self.path,) if self.limits_file is None else (self.path, self.limits_file)


def load_specification(path: Path | str) -> SuiteSpecification:
    """Read the file of a suite, and find its sources. The data of the sources are not read.

    Paths in the file are relative to its folder. ConfigError if the file is missing or invalid. InputError if no
    source is found, or if a file of a method cannot be read.
    """
    path = Path(path)
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
    settings = build(SuiteSettings, content, origin=str(path))
    if not lists["sources"]:
        raise ConfigError(f"{path}: 'sources' is missing or empty: give paths, globs or simulations")
    tasks = _tasks(lists["tasks"], path)
    if not settings.nominal and not lists["perturb"]:
        raise ConfigError(f"{path}: with 'nominal: false' at least one fault in 'perturb' is required")
    for faults in lists["perturb"]:
        with naming_key(f"{path}: 'perturb'"):
            for fault in str(faults).split("+"):
                parse_fault(fault)
    sources, refusals = _sources(lists["sources"], path)
    if budget:
        sources = [*_budget_sources(sources, budget, path)]
    if budget and (has_limits or lists["perturb"] or lists["tasks"] not in ([], ["localise"])):
        raise ConfigError(
            f"{path}: 'budget' cannot be combined with 'limits' or 'perturb', and requires 'tasks: [localise]'"
        )
    with naming_key(f"{path}: 'conditions'"):
        named = [Condition.parse(str(text)).setting for text in lists["conditions"] or ["distance=5"]]
    limits = parse_limits(stated_limits, f"{path}: limits") if has_limits else None
    named += () if limits is None else limits.conditions
    _check_effects(settings, limits, budget, path)
    conditions = tuple(dict.fromkeys(named))
    return SuiteSpecification(
        path=path,
        sources=tuple(sources),
        refusals=tuple(refusals),
        faults=(*([""] if settings.nominal else []), *map(str, lists["perturb"])),
        configurations=read_configurations(configurations, path),
        tasks=(JobTask.LOCALISE,) if budget else tasks,
        budget=tuple(source.name for source in budget),
        scoring=TrajectoryScoreConfig(conditions, settings.spacing, settings.rebase, settings.partial),
        limits=limits,
        stated_limits=stated_limits,
        limits_file=path.parent / limits_value if isinstance(limits_value, str) else None,
        kept_errors=() if limits is None else _kept_errors(limits),
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


def _check_effects(settings: SuiteSettings, limits: Limits | None, budget: Sequence[ErrorSource], path: Path) -> None:
    """Raise ConfigError if a setting has no effect in this suite."""
    is_sequential = [] if limits is None else [limit.good is not None for limit in limits.limits]
    if settings.stop_when_decided and not (is_sequential and all(is_sequential)):
        raise ConfigError(f"{path}: 'stop_when_decided' has no effect unless every limit has 'good': remove it")
    if settings.order_seed and not any(is_sequential):
        raise ConfigError(f"{path}: 'order_seed' has no effect without a limit with 'good': remove it")
    if budget and settings.repeats > 1:
        raise ConfigError(f"{path}: 'repeats' has no effect in a suite with 'budget': remove it, and give more seeds")


def limits_in(path: Path) -> Mapping[str, Any]:
    """Return the limits in the file of a suite, or in the limits file that it names; empty if there are none."""
    content = load_yaml(path)
    return _stated_limits(content["limits"], path) if "limits" in content else {}


def _tasks(names: Sequence[object], path: Path) -> tuple[JobTask, ...] | None:
    if unknown := [name for name in names if name not in list(JobTask)]:
        raise ConfigError(f"{path}: 'tasks' has {unknown[0]!r:.40}: {alternatives(JobTask)} is required")
    return tuple(JobTask(str(name)) for name in names) or None


def _sources(entries: Sequence[object], path: Path) -> tuple[list[StatedSource], list[Refusal]]:
    """Return the sources of the entries, and the entries that cannot be read; InputError if no entry can be read."""
    sources: list[StatedSource] = []
    refusals: list[Refusal] = []
    for number, entry in enumerate(entries, 1):
        try:
            found = list(read_entry(entry, path.absolute().parent, f"{path}: source {number}"))
            sources += [replace(source, entry=number) for source in found]
        except InputError as error:
            refusals.append(Refusal(str(entry), str(error), entry=number))
    if not sources:
        raise InputError(refusals[0].reason)
    return with_unique_names(sources), refusals


def _kept_errors(limits: Limits) -> tuple[tuple[str, str], ...]:
    """Return the figures and conditions with a limited tolerance bound, which requires the errors of all drives."""
    pairs = ((item.limited.figure, item.condition) for item in limits.limits if item.terms is not None)
    return tuple(sorted({(figure, condition) for figure, condition in pairs if condition is not None}))


def _budget_sources(
    sources: Sequence[StatedSource], budget: Sequence[ErrorSource], path: Path
) -> Iterator[StatedSimulation]:
    """Yield each simulation with each combination of the sources of error that the budget requires."""
    for source in sources:
        if not isinstance(source, StatedSimulation):
            raise ConfigError(
                f"{path}: 'budget' requires sources 'simulate: SCENARIO', but '{source.name}' is not simulated"
            )
        names: dict[tuple[str, str], str] = {}
        for variant in variants_of(budget):
            settings = variant.settings(source.settings)
            simulation = stated_simulation(Path(source.location), settings, source.seed, f"{path}: 'budget'")
            faults = variant.faults(source.seed)
            equal = names.setdefault((simulation.sha256, faults), variant.name)
            if equal != variant.name:
                raise ConfigError(
                    f"{path}: 'budget': the variants '{equal}' and '{variant.name}' of '{source.name}' are equal; each "
                    "source of error must change the scenario"
                )
            yield replace(simulation, name=source.name, entry=source.entry, variant=variant.name, faults=faults)


def _stated_limits(value: object, path: Path) -> Mapping[str, Any]:
    """Return the limits in a suite's file, or in the limits file that it names."""
    content = load_yaml(path.parent / value) if isinstance(value, str) else value
    if not isinstance(content, Mapping):
        raise ConfigError(
            f"{path}: 'limits' is {value!r:.40}: the name of a limits file, or limits as NAME: VALUE, is required"
        )
    return dict(content)
