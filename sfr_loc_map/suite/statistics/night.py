"""The nights of a history: the figures of one suite, as read from its `suite.json`, and the order of the nights."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise
from pathlib import Path

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.inputs import refusing
from sfr_loc_map.json_yaml import parse_json
from sfr_loc_map.suite.statistics.figures import ComparedKind, FigureName
from sfr_loc_map.suite.statistics.pairing import PairKey, without_configuration
from sfr_loc_map.suite.statistics.summary import SCHEMA

MAX_NUMBER = 1e100  #: Maximum number of a figure; its squares and sums are finite.


def _figure(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value <= MAX_NUMBER:
        raise ValueError(f"a figure is {value!r:.40}: a number of at least 0 is required")
    return float(value)


@dataclass(frozen=True, slots=True)
class Night:
    """One suite of a history. Labels, paths and figures are by job; a job without a result has no figures."""

    name: str
    commit: str | None
    labels: Mapping[PairKey, str]
    paths: Mapping[PairKey, str]  #: Paths of the sources.
    figures: Mapping[PairKey, Mapping[FigureName, float]]
    time: str = ""  #: Time of the run, ISO 8601 in UTC; empty if unknown.
    waiting: tuple[str, ...] = ()  #: Labels of the jobs that were not run, and paths of the refused sources.

    @property
    def without_result(self) -> tuple[str, ...]:
        """Labels of the planned jobs without a result, and paths of the refused sources."""
        failed = (label for key, label in self.labels.items() if key not in self.figures)
        return (*failed, *self.waiting)

    def is_copy_of(self, other: Night) -> bool:
        """Return whether two folders have the same night: the same time, commit and figures."""
        is_equal = (self.time, self.commit, self.figures) == (other.time, other.commit, other.figures)
        return bool(self.time) and is_equal

    @classmethod
    def read(cls, folder: Path) -> Night:
        """Read the night from `suite.json` of a folder."""
        path = folder / "suite.json"
        with refusing(f"cannot read the figures of '{path}'", f"make it with sfr suite report '{folder}'"):
            content = parse_json(path.read_bytes())
            if content["schema"] != SCHEMA:
                raise ValueError(f"its schema is {content['schema']}: {SCHEMA} is required")
            results = {PairKey(item["pairing"], item["configuration"]): item for item in content["drives"]}
            failures = {PairKey(item["pairing"], item["configuration"]): item for item in content["failures"]}
            jobs = results | failures
            labels = {key: item["label"] for key, item in jobs.items()}
            paths = {key: item.get("path") or item["source"] for key, item in jobs.items()}
            figures = {
                key: {FigureName(ComparedKind(kind), name): _figure(value) for kind, name, value in item["figures"]}
                for key, item in results.items()
            }
            commit = content["git"]["commit"]
            time = str(content.get("time") or "")
            refused = [str(item["path"]) for item in content.get("refusals", ())]
            waiting = (*map(str, content.get("waiting_jobs", ())), *refused)
        return cls(str(folder), commit, labels, paths, figures, time, waiting)

    def without_configurations(self) -> Night:
        """Return the night with jobs that are identified by their work and data only, not by their configuration."""
        labels = {without_configuration(key): label for key, label in self.labels.items()}
        paths = {without_configuration(key): path for key, path in self.paths.items()}
        figures = {without_configuration(key): of_job for key, of_job in self.figures.items()}
        return replace(self, labels=labels, paths=paths, figures=figures)


def check_order(nights: Sequence[Night]) -> None:
    """Raise MetricsError if a night is given twice, or is older than the night before.

    Nights without a time are not compared by their time.
    """
    places = [Path(night.name).resolve() for night in nights]
    for first, second in combinations(range(len(nights)), 2):
        if places[first] == places[second] or nights[first].is_copy_of(nights[second]):
            raise MetricsError(
                f"'{nights[first].name}' and '{nights[second].name}' are the same night: give each night once"
            )
    timed = [night for night in nights if night.time]
    for before, after in pairwise(timed):
        if after.time < before.time:
            raise MetricsError(
                f"'{after.name}' ({after.time}) is older than '{before.name}' ({before.time}): give the suites in the "
                "order of their time"
            )
