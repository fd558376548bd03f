"""Results of benchmarks: figures of each method, of each size, and where they were measured."""

from __future__ import annotations

import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from typing import Generic, Protocol, TypeVar

from sfr_loc_map import __version__
from sfr_loc_map.bench.figures import CallCosts, JsonObject, growth, median, ratios

SCHEMA = "sfr-bench/1"
OURS = "ours"
"""Name of our method in tables."""
CLOCK = "host monotonic"
MEMORY = (
    "kernel high-water mark of the process' resident memory (VmHWM), set back before each call; largest of all calls"
)


class RunFigures(Protocol):
    """Figures of one run of a method."""

    def to_json(self) -> JsonObject:
        """Return the JSON object."""
        ...


class CallFigures(RunFigures, Protocol):
    """Figures of one run of a method that is called for each pair."""

    @property
    def costs(self) -> CallCosts:
        """Time and memory of the calls."""
        ...


F = TypeVar("F", bound=RunFigures)
C = TypeVar("C", bound=CallFigures)


@dataclass(frozen=True, slots=True)
class Entry(Generic[F]):
    """Figures of one method.

    Attributes:
        label: Its version, or what it computes.
        runs: Figures of each run.
    """

    label: str
    runs: Sequence[F]

    @property
    def figures(self) -> F:
        """Medians over the runs."""
        return median(self.runs)

    def to_json(self, label: str = "version") -> JsonObject:
        """Return the JSON object; `label` is the key of the label."""
        return {label: self.label, **self.figures.to_json(), "runs": [run.to_json() for run in self.runs]}


def ratios_to_others(entries: Mapping[str, Entry[F]], ours: str, parts: Sequence[str]) -> JsonObject:
    """Return the ratios of ours to every other entry over some of the parts of their figures."""
    figures = {name: entry.figures.to_json() for name, entry in entries.items()}
    mine = {part: figures[ours].get(part, {}) for part in parts}
    return {name: ratios(mine, other) for name, other in figures.items() if name != ours}


@dataclass(frozen=True, slots=True)
class SizeResult(Generic[C]):
    """Figures of all methods at one size of the images.

    Attributes:
        width: Pixels.
        height: Pixels.
        disparities: Number of disparities searched, of matchers.
        entries: Methods that completed every pass, by name.
        failed: Reason why the others did not, by name.
        findings: What methods did wrong in calls after which they went on, by name.
    """

    width: int
    height: int
    disparities: int | None
    entries: Mapping[str, Entry[C]]
    failed: Mapping[str, str]
    findings: Mapping[str, Sequence[str]] = field(default_factory=dict)

    @property
    def work(self) -> int:
        """Number of pixels, times that of the disparities searched."""
        return self.width * self.height * (self.disparities or 1)

    def to_json(self) -> JsonObject:
        """Return the JSON object."""
        searched = {} if self.disparities is None else {"disparities": self.disparities}
        return (
            {"width": self.width, "height": self.height}
            | searched
            | {
                "entries": {name: entry.to_json() for name, entry in self.entries.items()},
                "ratios": ratios_to_others(self.entries, OURS, ("accuracy", "time_s", "memory_bytes")),
                "failed": dict(self.failed),
            }
            | ({"findings": {name: list(texts) for name, texts in self.findings.items()}} if self.findings else {})
        )


def growth_by_method(sizes: Sequence[SizeResult[C]]) -> dict[str, float | None]:
    """Return the exponent of the median time over the work, of each method that ran at every size."""
    names = [name for name in sizes[0].entries if all(name in size.entries for size in sizes)]
    times = {name: [size.entries[name].figures.costs.time_s.p50 or 0.0 for size in sizes] for name in names}
    return {name: growth([size.work for size in sizes], seconds) for name, seconds in times.items()}


@dataclass(frozen=True, slots=True)
class Host:
    """Machine of a benchmark."""

    machine: str
    system: str
    python: str
    cores: int | None
    load_at_start: float


@dataclass(frozen=True, slots=True)
class Provenance:
    """Version, host and time of a benchmark."""

    version: str
    clock: str
    memory_method: str
    host: Host
    time: str

    @classmethod
    def now(cls, memory_method: str = MEMORY) -> Provenance:
        """Return the provenance of a benchmark that starts now."""
        load = os.getloadavg()[0]
        host = Host(platform.machine(), platform.system(), platform.python_version(), os.cpu_count(), load)
        return cls(__version__, CLOCK, memory_method, host, datetime.now(UTC).isoformat(timespec="seconds"))


@dataclass(frozen=True, slots=True)
class MethodComparison(Generic[C]):
    """Result of the benchmark of localisers or of matchers.

    Attributes:
        kind: `localise` or `map`.
        pairs: Number of pairs.
        conditions: Ends of sub-trajectories, of localisers.
        repeat: Number of passes.
        sizes: One result for each size of the images.
        missing: Reason why a reference method was not run, by name.
        provenance: Where and when.
    """

    kind: str
    pairs: int
    conditions: tuple[str, ...] | None
    repeat: int
    sizes: Sequence[SizeResult[C]]
    missing: Mapping[str, str]
    provenance: Provenance

    def to_json(self) -> JsonObject:
        """Return the JSON object."""
        head: JsonObject = {"schema": SCHEMA, "kind": self.kind, "pairs": self.pairs}
        if self.conditions is not None:
            head["conditions"] = list(self.conditions)
        return head | {
            "repeat": self.repeat,
            "sizes": [size.to_json() for size in self.sizes],
            "growth": growth_by_method(self.sizes),
            "missing": dict(self.missing),
            "provenance": asdict(self.provenance),
        }
