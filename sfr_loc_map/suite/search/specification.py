"""Read the file of a search (docs/suites.md): a scenario, ranges of parameters, and a figure with its limit."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sfr_loc_map.configuration.parameters import build, flatten, param
from sfr_loc_map.configuration.yaml_file import entries_by_name, load_yaml
from sfr_loc_map.errors import ConfigError, naming_key
from sfr_loc_map.faults.kinds import FaultKind, parse_fault, with_amount
from sfr_loc_map.message_text import alternatives
from sfr_loc_map.metrics.conditions import Condition
from sfr_loc_map.metrics.config import CallKind, Reading, TrajectoryScoreConfig
from sfr_loc_map.metrics.figures.catalogue import ALIGNED, CATALOGUE, KINDS, UNANSWERED, Content, FigureKind
from sfr_loc_map.metrics.figures.row_part import DIRECTIONS, MOVING, OTHER_FRAMES, distance_of
from sfr_loc_map.metrics.figures.subjects import Subject
from sfr_loc_map.metrics.formulas import STATISTICS
from sfr_loc_map.metrics.score.limits import OF_MAP
from sfr_loc_map.metrics.score.score import JUDGED_ROW, Score
from sfr_loc_map.simulation.config import SimulationConfig
from sfr_loc_map.suite.jobs.digests import code_fingerprint
from sfr_loc_map.suite.jobs.job import Job, JobTask
from sfr_loc_map.suite.planning.source_entries import changed_scenario, scenario_settings, simulation_of
from sfr_loc_map.suite.planning.specification import SuiteSettings, check_keys
from sfr_loc_map.suite.search.record import Parameter

Point = tuple[float, ...]
"""Values of the parameters of a search, in the order of the file."""
CHOICES = (*STATISTICS, "value")  #: Statistics that a search accepts.
SUBJECTS = (Subject.TRAJECTORY, Subject.TIMING, Subject.MEMORY, Subject.COMPLETENESS, Subject.CONSISTENCY)
"""Subjects of the figures that the score of a localised drive can have."""
NOT_OF_A_DRIVE = (
    *ALIGNED,
    *OF_MAP,
    *(kind.name for kind in CATALOGUE if kind.is_without_height),
    *(kind.value for kind in CallKind if kind is not CallKind.LOCALISATION),
    *(UNANSWERED, "dropped", "restarts", "publisher_changes", "inputs_changed"),
)
"""Figures of these subjects that require an alignment, a ground truth without heights, maps, running nodes or a file.
"""
STRUCTURED = ("scenario", "set", "ranges", "seeds", "running")
"""Keys of a search that are not scalar settings."""
WITHOUT_EFFECT = ("repeats", "stop_when_decided", "nominal")
"""Settings of a suite that a search rejects, because they would have no effect."""


@dataclass(frozen=True, slots=True)
class SearchSettings:
    """Scalar settings of a search."""

    figure: str = param("position", doc="Figure whose worst case is searched (`figure` in the score's table).")
    statistic: str = param("mean_plus_3sigma", doc="Statistic of the figure.", choices=CHOICES)
    part: str = param("", doc="Part of the figure. Empty: the judged part.")
    condition: str = param("distance=5", doc="Condition of the sub-trajectories.")
    limit: float = param(0.1, doc="Upper limit of the figure, in its unit.", low=1e-12, high=1e12)
    points: int = param(
        100,
        doc="Number of points that are searched. Points that simplify the worst case afterwards are not counted.",
        low=1,
        high=10**6,
    )
    batch: int = param(
        4,
        doc="Number of points that are chosen and run together. The first point of each batch is drawn uniformly "
        "from the ranges.",
        low=2,
        high=1000,
    )
    seed: int = param(0, doc="Seed of the search.", low=0, high=2**31 - 1)
    slices: int = param(5, doc="Number of points along each side of a slice. 0: no slices.", low=0, high=50)


@dataclass(frozen=True, slots=True)
class SearchSpecification:
    """A search, and the conversion of its points to jobs."""

    path: Path  #: The file.
    scenario: Path
    base: Mapping[str, object]  #: All settings of the scenario, with the changes of the file.
    changes: Mapping[str, object]  #: Settings that the file changes.
    seeds: tuple[int, ...]  #: Seeds with which each point is run. The ratio of a point is that of its worst seed.
    parameters: tuple[Parameter, ...]
    scoring: TrajectoryScoreConfig
    settings: SearchSettings
    running: SuiteSettings  #: Settings of the jobs; those in `WITHOUT_EFFECT` have their defaults.
    code: str  #: Fingerprint of the code at the start of the search, so that later changes repeat no point.

    @property
    def usual(self) -> Point:
        """Point of the unchanged scenario."""
        return tuple(parameter.usual for parameter in self.parameters)

    def named(self, point: Point) -> dict[str, float]:
        """Return the values of a point by parameter name."""
        pairs = zip(self.parameters, point, strict=True)
        return {parameter.name: value for parameter, value in pairs}

    def settings_at(self, point: Point) -> dict[str, object]:
        """Return the settings of the scenario at a point."""
        pairs = zip(self.parameters, point, strict=True)
        return {
            parameter.name: int(value) if parameter.is_whole else value
            for parameter, value in pairs
            if not parameter.fault
        }

    def faults_at(self, point: Point) -> str:
        """Return the faults of a point, joined by `+`; a fault without effect is omitted."""
        return "+".join(
            with_amount(parameter.fault, value)
            for parameter, value in zip(self.parameters, point, strict=True)
            if parameter.fault and value != parameter.usual
        )

    def jobs_at(self, point: Point) -> list[Job]:
        """Return the jobs of a point, one for each seed."""
        return [self._job(point, seed) for seed in self.seeds]

    def _job(self, point: Point, seed: int) -> Job:
        settings = {**self.base, **self.settings_at(point)}
        return Job(
            task=JobTask.LOCALISE,
            source=simulation_of(self.scenario, settings, seed, str(self.path)),
            faults=self.faults_at(point),
            fault_seed=self.running.seed,
            configuration="default",
            start=self.running.start,
            scoring=self.scoring,
            repeat=0,
            threads=self.running.threads,
            code=self.code,
        )

    def ratio_of(self, score: Score) -> float | None:
        """Return the figure divided by its limit, above 1 for a miss; None without the figure."""
        chosen = self.settings
        value = score.number(chosen.figure, chosen.statistic, part=chosen.part or JUDGED_ROW)  # there is one condition
        return None if value is None else abs(value) / chosen.limit


def load_search(path: Path | str) -> SearchSpecification:
    """Read the file of a search and its scenario, whose path is relative to the folder of the file.

    ConfigError if a file is missing or invalid, if a bound of a range is invalid in the scenario, or if a setting would
    have no effect.
    """
    path = Path(path)
    content = load_yaml(path)
    check_keys(content, (*STRUCTURED, *flatten(SearchSettings())), path)
    scenario_name, stated_changes = content.pop("scenario", None), _mapping_in(content, "set", path)
    ranges, seeds = _mapping_in(content, "ranges", path), content.pop("seeds", [1])
    stated_running = _mapping_in(content, "running", path)
    running = build(SuiteSettings, stated_running, origin=f"{path}: running")
    if rejected := [name for name in WITHOUT_EFFECT if name in stated_running]:
        raise ConfigError(f"{path}: running: '{rejected[0]}' has no effect in a search: remove it")
    settings = build(SearchSettings, content, origin=str(path))
    _check_figure(settings, path)
    if not isinstance(scenario_name, str):
        raise ConfigError(f"{path}: the file of a scenario is required for 'scenario'")
    is_list = isinstance(seeds, list) and all(type(seed) is int for seed in seeds)
    if not is_list or not seeds or len(set(seeds)) < len(seeds):
        raise ConfigError(f"{path}: a list of different whole numbers is required for 'seeds'")
    if not ranges:
        raise ConfigError(f"{path}: 'ranges' is missing or empty: give parameters as NAME: [LOW, HIGH]")
    with naming_key(f"{path}: 'set'"):
        changes = flatten(stated_changes)
    for name, settings_of_file in (("ranges", ranges), ("set", changes)):
        if "seed" in settings_of_file:
            raise ConfigError(f"{path}: 'seed' in '{name}' has no effect: give 'seeds'")
    scenario = path.absolute().parent / scenario_name
    given = scenario_settings(scenario)
    base = changed_scenario(scenario, changes, f"{path}: 'set'")
    for seed in seeds:
        simulation_of(scenario, base, seed, f"{path}: 'seeds'")
    with naming_key(f"{path}: 'condition'"):
        condition = Condition.parse(settings.condition).setting
    parameters = tuple(_parameter(name, value, base, f"{path}: '{name}'") for name, value in ranges.items())
    _check_faults(parameters, base, path)
    return SearchSpecification(
        path=path,
        scenario=scenario,
        base=base,
        changes={name: value for name, value in base.items() if value != given[name]},
        seeds=tuple(seeds),
        parameters=parameters,
        scoring=TrajectoryScoreConfig((condition,), running.spacing, running.rebase, running.partial),
        settings=settings,
        running=running,
        code=code_fingerprint(),
    )


def _mapping_in(content: dict[str, Any], name: str, path: Path) -> dict[str, Any]:
    """Remove a mapping from the content of a file and return it; empty if the file has no value for it."""
    value = content.pop(name, None)
    if value is None:
        return {}
    if not isinstance(value, Mapping):
        raise ConfigError(f"{path}: '{name}' is {value!r:.40}: names with values (NAME: VALUE) are required")
    return entries_by_name(value, f"{path}: '{name}'")


def _check_figure(settings: SearchSettings, path: Path) -> None:
    """Raise ConfigError if the score of a localised drive has no such figure, statistic or part.

    The parts of the other figures, such as the stages of a call, are checked with the unchanged scenario.
    """
    kind = KINDS.get(settings.figure)
    if kind is None or kind.subject not in SUBJECTS or kind.name in NOT_OF_A_DRIVE:
        known = (name for name, each in KINDS.items() if each.subject in SUBJECTS and name not in NOT_OF_A_DRIVE)
        raise ConfigError(
            f"{path}: 'figure: {settings.figure}' is not a figure of a localised drive; one of {', '.join(known)} is "
            "required"
        )
    is_one_number = kind.content is not Content.STATISTICS
    if is_one_number != (settings.statistic == "value"):
        required = "value" if is_one_number else ", ".join(STATISTICS)
        raise ConfigError(
            f"{path}: 'statistic: {settings.statistic}' is not a statistic of {kind.name}; {required} is required"
        )
    parts = _parts_of(kind)
    if parts and settings.part not in parts and distance_of(settings.part) is None:
        raise ConfigError(
            f"{path}: 'part: {settings.part}' is not a part of {kind.name}; "
            f"{alternatives([part for part in parts if part])} is required"
        )


def _parts_of(kind: FigureKind) -> tuple[str, ...]:
    """Return the parts of a figure, of which the empty part is the judged one; empty if they depend on the drive."""
    if kind.subject is Subject.MEMORY:
        return (CallKind.LOCALISATION,)
    if kind.compute_errors is None:
        return ()
    readings = [reading for reading in Reading if not reading.is_fit]
    directions = DIRECTIONS if kind.name == "position" else ()
    return ("", *readings, *directions, MOVING, OTHER_FRAMES)


def _check_faults(parameters: Sequence[Parameter], base: Mapping[str, object], path: Path) -> None:
    """Raise ConfigError if a fault has the name of a setting, or if two parameters vary the amount of one fault."""
    names: dict[str, str] = {}
    for parameter in parameters:
        if not parameter.fault:
            continue
        if parameter.name in base:
            raise ConfigError(f"{path}: '{parameter.name}' is a setting of the scenario: give the fault another name")
        equal = names.setdefault(parameter.fault, parameter.name)
        if equal != parameter.name:
            raise ConfigError(
                f"{path}: '{equal}' and '{parameter.name}' are ranges of the fault '{parameter.fault}': omit one"
            )


def _parameter(name: str, value: object, base: Mapping[str, object], origin: str) -> Parameter:
    if isinstance(value, Mapping):
        if set(value) != {"fault", "range"}:
            raise ConfigError(f"{origin} requires 'fault: KIND' and 'range: [LOW, HIGH]' of the amount")
        if not re.fullmatch(r"[\w .-]+", name):
            raise ConfigError(f"{origin}: the name may have only letters, digits, spaces, '_', '.' and '-'")
        low, high = _bounds(value["range"], origin)
        fault = str(value["fault"])
        with naming_key(origin):
            kind: FaultKind = parse_fault(fault).kind
            for amount in (low, high):
                parse_fault(with_amount(fault, amount))
        if kind.info.neutral is None:
            raise ConfigError(
                f"{origin}: '{kind}' has an effect at every amount: give a fault that leaves the scenario unchanged at "
                f"some amount, such as {FaultKind.EXPOSURE}"
            )
        return Parameter(name, low, high, kind.info.neutral, fault)
    low, high = _bounds(value, origin)
    usual = base.get(name)
    if isinstance(usual, bool) or not isinstance(usual, int | float):
        raise ConfigError(
            f"{origin} is not a numeric setting of the scenario; give a setting such as light.sun_elevation_deg"
        )
    whole = isinstance(usual, int)
    if whole and not (low.is_integer() and high.is_integer()):
        raise ConfigError(f"{origin} is {value}: the setting is a whole number, so whole bounds are required")
    for bound in (low, high):
        build(SimulationConfig, {**base, name: int(bound) if whole else bound}, origin=origin)
    return Parameter(name, low, high, float(usual), is_whole=whole)


def _bounds(value: object, origin: str) -> tuple[float, float]:
    is_pair = isinstance(value, list) and len(value) == 2
    numbers = [float(item) for item in value if type(item) in (int, float)] if isinstance(value, list) else []
    if not is_pair or len(numbers) != 2 or not numbers[0] < numbers[1]:
        raise ConfigError(f"{origin} is {value}: a range [LOW, HIGH] with LOW below HIGH is required")
    return numbers[0], numbers[1]
