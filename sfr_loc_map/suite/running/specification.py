"""The file of a suite (docs/suites.md): sources, faults, configurations and tasks."""

from __future__ import annotations

import glob
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from sfr_loc_map.config import build, flatten, load_yaml, param
from sfr_loc_map.errors import ConfigError, InputError
from sfr_loc_map.faults.kinds import parse_fault
from sfr_loc_map.metrics.config import Condition, TrajectoryScoreConfig
from sfr_loc_map.metrics.judging.limits_file import parse_limits
from sfr_loc_map.metrics.limits import Limits
from sfr_loc_map.simulation.config import SimulationConfig
from sfr_loc_map.suite.running.configurations import read_configurations
from sfr_loc_map.suite.running.job import JobKind, JobSource, SourceKind, digest
from sfr_loc_map.suite.running.sources import expand
from sfr_loc_map.suite.running.variants import ErrorSource, parse_budget, variants_of

LISTS = ("sources", "perturb", "tasks", "conditions")


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
    stop_when_decided: bool = param(
        False, doc="Stop when sequential tests (`good` of a limit) have decided all limits."
    )
    start: str = param("truth", doc="First pose of a drive.", choices=("identity", "truth"))
    repeats: int = param(1, doc="Number of runs of each job.", low=1, high=1000)
    seed: int = param(0, doc="Seed that selects the pairs that a fault affects.", low=0, high=2**31 - 1)
    threads: int = param(1, doc="Number of threads of a job.", low=1, high=256)
    memory_mb: int = param(
        4000, unit="MB", doc="Resident memory above which the process of a job is killed.", low=500, high=10**6
    )
    timeout_s: float = param(
        3600.0, unit="s", doc="Time after which a job is killed. A job is tried three times.", low=0.1, high=1e7
    )
    wait_s: float = param(300.0, unit="s", doc="Maximum time without a worker that may run a job.", low=0.1, high=1e7)


@dataclass(frozen=True, slots=True)
class Refusal:
    """A source that cannot be read, or that has a result but no job any more, and the reason."""

    path: str  #: Path or URL of an unreadable source; name of a source with a result.
    reason: str


@dataclass(frozen=True, slots=True)
class SuiteSpecification:
    """Content of the file of a suite."""

    path: Path  #: File of the suite.
    sources: tuple[JobSource, ...]  #: One for each match and each seed; files have no hashes yet.
    refusals: tuple[Refusal, ...]  #: Entries without a match, or with a server that does not answer.
    faults: tuple[str, ...]  #: Injected faults; the source without faults comes first, as an empty text.
    configurations: Mapping[str, Mapping[str, object]]  #: Parameters of each configuration, by dotted name.
    tasks: tuple[JobKind, ...] | None  #: Requested tasks; None: those of `DEFAULT_TASKS` for which a source has data.
    budget: tuple[str, ...]  #: Names of the sources of error of a budget; empty if there is none.
    scoring: TrajectoryScoreConfig  #: Settings of the scores, including conditions that only the limits name.
    limits: Mapping[str, Any]  #: Limits; empty if there are none.
    limits_file: Path | None  #: File of the limits; None if they are in the suite's file or missing.
    kept_errors: tuple[tuple[str, str], ...]  #: Figures and conditions with a limited tolerance bound.
    settings: SuiteSettings  #: Scalar settings.

    @property
    def files(self) -> tuple[Path, ...]:
        """The file of the suite, and the file of its limits if there is one."""
        return (self.path,) if self.limits_file is None else (self.path, self.limits_file)


def load_specification(path: Path) -> SuiteSpecification:
    """Read the file of a suite."""
    content = load_yaml(path)
    lists = {name: content.pop(name, None) or [] for name in LISTS}
    budget = parse_budget(content.pop("budget"), str(path)) if "budget" in content else ()
    configurations = content.pop("configurations", None)
    stated_limits = content.pop("limits", None)
    limits = _limits(stated_limits, path)
    settings = build(SuiteSettings, content, origin=str(path))
    if odd := next((name for name, value in lists.items() if not isinstance(value, list)), None):
        raise ConfigError(f"{path}: '{odd}' is a {type(lists[odd]).__name__}: a list is required")
    if not lists["sources"]:
        raise ConfigError(f"{path}: no 'sources': give paths, globs or simulations")
    try:
        tasks = tuple(JobKind(str(name)) for name in lists["tasks"]) or None
    except ValueError as error:
        raise ConfigError(f"{path}: 'tasks' may contain {', '.join(JobKind)}: {error}") from error
    for faults in lists["perturb"]:
        for fault in str(faults).split("+"):
            parse_fault(fault)
    sources: list[JobSource] = []
    refusals: list[Refusal] = []
    for number, entry in enumerate(lists["sources"], 1):
        try:
            sources += list(_sources(entry, path.absolute().parent, f"{path}: source {number}"))
        except InputError as error:
            refusals.append(Refusal(str(entry), str(error)))
    if not sources:
        raise InputError(refusals[0].reason)
    sources = with_distinct_simulations(sources)
    if budget:
        sources = list(_budget_sources(sources, budget, path))
    if budget and (limits or lists["perturb"] or lists["tasks"] not in ([], ["localise"])):
        raise ConfigError(
            f"{path}: 'budget' cannot be combined with 'limits' or 'perturb', and requires 'tasks: [localise]'"
        )
    named = [Condition.parse(str(text)).setting for text in lists["conditions"] or ["distance=5"]]
    parsed = parse_limits(limits, f"{path}: limits") if limits else None
    named += () if parsed is None else parsed.conditions
    conditions = tuple(dict.fromkeys(named))
    return SuiteSpecification(
        path=path,
        sources=tuple(sources),
        refusals=tuple(refusals),
        faults=("", *map(str, lists["perturb"])),
        configurations=read_configurations(configurations, path),
        tasks=(JobKind.LOCALISE,) if budget else tasks,
        budget=tuple(source.name for source in budget),
        scoring=TrajectoryScoreConfig(conditions, settings.spacing, settings.rebase, settings.partial),
        limits=limits,
        limits_file=path.parent / stated_limits if isinstance(stated_limits, str) else None,
        kept_errors=() if parsed is None else _kept_errors(parsed),
        settings=settings,
    )


def limits_in(path: Path) -> Mapping[str, Any]:
    """Return the limits in the file of a suite, or in the limits file that it names; empty if there are none."""
    return _limits(load_yaml(path).get("limits"), path)


def _kept_errors(limits: Limits) -> tuple[tuple[str, str], ...]:
    """Return the figures and conditions with a limited tolerance bound, which requires the errors of all drives."""
    pairs = ((item.limited.figure, item.condition) for item in limits.limits if item.terms is not None)
    return tuple(sorted({(figure, condition) for figure, condition in pairs if condition is not None}))


def _sources(entry: object, folder: Path, origin: str) -> Iterator[JobSource]:
    if isinstance(entry, str) and "://" in entry:
        if not (urls := expand(entry)):
            raise InputError(f"source '{entry}': no match; give an existing URL or glob")
        yield from (_source(SourceKind.REMOTE, url) for url in urls)
    elif isinstance(entry, str) and entry:
        found = sorted(glob.glob(str(folder / entry), recursive=True))
        if not found:
            raise InputError(f"source '{entry}': no match in '{folder}'; give an existing path or glob")
        yield from (_source(SourceKind.FILE, path) for path in found)
    elif isinstance(entry, Mapping) and set(entry) == {"estimate", "truth"}:
        path, truth = (str(folder / str(entry[name])) for name in ("estimate", "truth"))
        yield _source(SourceKind.ESTIMATE, path, truth=truth)
    elif isinstance(entry, Mapping) and "simulate" in entry:
        yield from _simulations(entry, folder, origin)
    else:
        raise ConfigError(
            f"{origin}: needs a path or URL, 'simulate: SCENARIO', or 'estimate: EST' with 'truth: TRUTH'"
        )


def _source(kind: SourceKind, path: str, *, truth: str = "", sha256: str = "") -> JobSource:
    return JobSource(name=path.rstrip("/").rpartition("/")[2], kind=kind, path=path, truth=truth, sha256=sha256)


def _simulations(entry: Mapping[str, Any], folder: Path, origin: str) -> Iterator[JobSource]:
    seeds, changes = entry.get("seeds", [0]), entry.get("set", {})
    whole = isinstance(seeds, list) and all(isinstance(seed, int) and not isinstance(seed, bool) for seed in seeds)
    if set(entry) - {"simulate", "seeds", "set"} or not whole or not seeds or not isinstance(changes, Mapping):
        raise ConfigError(f"{origin}: 'simulate' takes 'seeds', a list of whole numbers, and 'set', a mapping")
    scenario = folder / str(entry["simulate"])
    settings = scenario_settings(scenario) | dict(changes)
    for seed in seeds:
        yield simulated_source(scenario, settings, seed, f"{scenario}: 'set'")


def scenario_settings(scenario: Path) -> dict[str, object]:
    """Return all settings of a scenario by dotted name. The seed is 0, because each drive has its own seed."""
    return flatten(build(SimulationConfig, load_yaml(scenario) | {"seed": 0}, origin=str(scenario)))


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


def with_distinct_simulations(sources: Sequence[JobSource]) -> list[JobSource]:
    """Return the sources; simulations with equal names and different settings get distinct names.

    If the scenarios differ, their folder is part of the name. If the names are still equal, the settings that differ
    are part of the name.
    """
    return _renamed(_renamed(sources, _name_with_folder), _name_with_settings)


def _renamed(sources: Sequence[JobSource], name_of: Callable[[JobSource, Sequence[JobSource]], str]) -> list[JobSource]:
    """Return the sources; simulations that share a name, but not the settings, are named by `name_of`."""
    of_name: dict[str, list[JobSource]] = {}
    for source in sources:
        if source.kind is SourceKind.SIMULATED:
            of_name.setdefault(source.name, []).append(source)
    renamed = []
    for source in sources:
        equal = of_name.get(source.name, []) if source.kind is SourceKind.SIMULATED else []
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


def _budget_sources(sources: Sequence[JobSource], budget: Sequence[ErrorSource], path: Path) -> Iterator[JobSource]:
    """Yield each simulation with each combination of the sources of error that the budget requires."""
    for source in sources:
        if source.kind is not SourceKind.SIMULATED:
            raise ConfigError(
                f"{path}: 'budget' requires sources 'simulate: SCENARIO', but '{source.name}' is not simulated"
            )
        for variant in variants_of(budget):
            settings = variant.settings(source.settings)
            made = simulated_source(Path(source.path), settings, source.seed, f"{path}: 'budget'")
            yield replace(made, name=source.name, variant=variant.name, faults=variant.faults(source.seed))


def _limits(value: object, path: Path) -> Mapping[str, Any]:
    if value is None:
        return {}
    content = load_yaml(path.parent / value) if isinstance(value, str) else value
    if not isinstance(content, Mapping):
        raise ConfigError(f"{path}: 'limits' must be a file or a mapping")
    return dict(content)
