"""Comparison of several methods on the same pairs: accuracy, time and memory.

In each pass, one method at a time processes all pairs, so that the times of the methods can be compared. The jobs of a
suite, in contrast, run concurrently. Figures are medians over the passes.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Generic

import numpy as np

from sfr_loc_map.bench.figure_rows import MEMORY, TIME, FigureRow, medians, nested, ratios
from sfr_loc_map.bench.provenance import SCHEMA, provenance
from sfr_loc_map.bench.trials import Item, Opened, Result, Trial
from sfr_loc_map.errors import MethodError
from sfr_loc_map.host_clock import checked_clock
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.methods.method_call import MethodCall
from sfr_loc_map.methods.registry import BUILT_IN, OURS_IN_TABLES, PEERS, Method, find_method, find_peer
from sfr_loc_map.signals import hold
from sfr_loc_map.suite_names import Task
from sfr_loc_map.tables.model import MIB, MILLISECOND, Column


@dataclass(frozen=True, slots=True)
class MethodEntry:
    """Figures of one method: the medians over the passes, and the figures of each pass."""

    version: str
    medians: Sequence[FigureRow]
    passes: Sequence[Sequence[FigureRow]]

    def content(self) -> dict[str, Any]:
        """Return the entry for the JSON file."""
        return {"version": self.version, **nested(self.medians), "runs": [nested(rows) for rows in self.passes]}


@dataclass(frozen=True, slots=True, kw_only=True)
class MethodBenchmark:
    """Figures of several methods on the same pairs."""

    kind: str  #: `localise` or `map`.
    title: str  #: Title of the table.
    pairs: int  #: Number of pairs of the source.
    repeat: int  #: Number of passes of each method.
    settings: Mapping[str, object]  #: Settings of the trial.
    provenance: Mapping[str, Any]
    entries: Mapping[str, MethodEntry]  #: Figures by method name; the suite's own method is the first.
    failed: Mapping[str, str]  #: Why methods have no entry, by method name.
    findings: Mapping[str, list[str]]  #: Findings during the calls, by method name.
    interrupted: str = ""  #: Number of finished passes if the user interrupted the benchmark; otherwise empty.

    @property
    def ratios(self) -> dict[str, list[FigureRow]]:
        """Ratios of the figures of our method to those of each other method, by method name."""
        ours = self.entries[OURS_IN_TABLES].medians
        others = {name: entry.medians for name, entry in self.entries.items() if name != OURS_IN_TABLES}
        return {name: list(ratios(ours, rows)) for name, rows in others.items()}

    def content(self) -> dict[str, Any]:
        """Return the content of the JSON file."""
        content: dict[str, Any] = {
            "schema": SCHEMA,
            "kind": self.kind,
            "pairs": self.pairs,
            "repeat": self.repeat,
            "provenance": dict(self.provenance),
            **self.settings,
            "entries": {name: entry.content() for name, entry in self.entries.items()},
            "ratios": {name: nested(rows) for name, rows in self.ratios.items()},
            "failed": dict(self.failed),
            "findings": dict(self.findings),
        }
        return content | ({"interrupted": self.interrupted} if self.interrupted else {})


def methods_to_compare(
    task: Task,
    config: LocalisationConfig | MappingConfig,
    peer_python: Path | None = None,
    vocabulary: Path | None = None,
    added: Sequence[str] = (),
) -> tuple[list[Method], dict[str, str]]:
    """Return the methods of a comparison, ours with its configuration first and `added` last.

    The second value gives, by name, the reasons why peers are missing.
    """
    ours, *others = BUILT_IN[task].values()
    present = [replace(ours, name=OURS_IN_TABLES, config=json.dumps(asdict(config))), *others]
    missing: dict[str, str] = {}
    for name, peer in PEERS[task].items():
        found, reason = find_peer(peer, peer_python, vocabulary)
        if found is None:
            missing[name] = reason
        else:
            present.append(found)
    names = [method.name for method in present]
    found_added = [find_method(spec, task) for spec in dict.fromkeys(added)]
    return [*present, *(method for method in found_added if method.name not in names)], missing


def compare_methods(
    trial: Trial[Item, Opened, Result],
    methods: Sequence[Method],
    *,
    repeat: int = 3,
    progress: Callable[[], None] = lambda: None,
) -> MethodBenchmark:
    """Run the passes of all methods in turn, `repeat` times, and return their figures.

    If our method fails, the MethodError is raised; other methods that fail are skipped. After an interrupt, the
    finished passes are reported.
    """
    begun = provenance()
    passes: dict[str, list[PassResult[Result]]] = {}
    failed: dict[str, str] = {}
    is_interrupted = False
    for method in [*methods] * repeat:
        if method.name in failed:
            continue
        try:
            passed = run_pass(method, trial, progress)
        except MethodError as error:
            if method.name == OURS_IN_TABLES:
                raise
            failed[method.name] = str(error)
        except KeyboardInterrupt:
            if OURS_IN_TABLES not in passes:
                raise
            is_interrupted = True
            break
        else:
            passes.setdefault(method.name, []).append(passed)
    hold()
    complete = {name: of_method for name, of_method in passes.items() if name not in failed}
    finished = sum(len(of_method) for of_method in complete.values())
    return MethodBenchmark(
        kind=trial.kind,
        title=trial.title,
        pairs=len(trial),
        repeat=repeat,
        settings=trial.settings,
        provenance=begun,
        entries={name: _entry(trial, of_method) for name, of_method in complete.items()},
        failed=failed,
        findings={name: texts for name, of_method in complete.items() if (texts := _findings(of_method))},
        interrupted=f"{finished} of {len(methods) * repeat} passes" if is_interrupted else "",
    )


def _entry(trial: Trial[Item, Opened, Result], passes: Sequence[PassResult[Result]]) -> MethodEntry:
    rows = [[*trial.figures(passed.results), *passed.costs()] for passed in passes]
    return MethodEntry(passes[0].version, medians(rows), rows)


def _findings(passes: Sequence[PassResult[Result]]) -> list[str]:
    """Return the findings of the calls in all passes, each text once."""
    return list(dict.fromkeys(call.finding for passed in passes for call in passed.calls if call.finding))


# ---- a pass: one method processes all pairs of the source


@dataclass(frozen=True, slots=True, eq=False)
class PassResult(Generic[Result]):
    """Calls and results of one method in one pass."""

    version: str
    idle_bytes: int | None  #: Resident memory after warm-up; None if unknown.
    calls: Sequence[MethodCall]
    results: Sequence[Result]

    def costs(self) -> Iterator[FigureRow]:
        """Yield times and memory of the calls. A call that did not return has no time."""
        times_s = [call.usage.processing_time_s for call in self.calls]
        known_s = [time_s for time_s in times_s if time_s is not None]
        p50, p95 = np.percentile(known_s, (50.0, 95.0)).tolist() if known_s else (None, None)
        yield FigureRow((TIME, "p50"), p50, Column("p50", MILLISECOND))
        yield FigureRow((TIME, "p95"), p95, Column("p95", MILLISECOND))
        yield FigureRow((TIME, "max"), max(known_s, default=None), Column("max", MILLISECOND))
        yield FigureRow((TIME, "first"), times_s[0] if times_s else None)
        peaks = [call.usage.peak_rss_bytes for call in self.calls if call.usage.peak_rss_bytes is not None]
        yield FigureRow((MEMORY, "peak"), max(peaks, default=None), Column("peak", MIB))
        yield FigureRow((MEMORY, "idle"), self.idle_bytes)
        yield FigureRow(("calls",), len(times_s))
        yield FigureRow(("calls_without_time",), len(times_s) - len(known_s))


def run_pass(
    method: Method, trial: Trial[Item, Opened, Result], progress: Callable[[], None] = lambda: None
) -> PassResult[Result]:
    """Process all pairs with a method; raise MethodError if the process does not start or has ended.

    The method receives the pairs at the rate of their stamps if the trial is paced, otherwise as fast as it answers.
    """
    calls: list[MethodCall] = []
    results: list[Result] = []
    with checked_clock(), trial.open(method) as opened:
        is_paced = trial.is_paced(method)
        begin_s, first_ns = time.monotonic(), None
        for stamp_ns, item in trial.items():
            first_ns = stamp_ns if first_ns is None else first_ns
            if is_paced:
                since_start_s = (stamp_ns - first_ns) / NS_PER_S / trial.rate_scale
                time.sleep(max(0.0, begin_s + since_start_s - time.monotonic()))
            result, call = trial.call(opened, item)
            if not opened.is_running:
                raise MethodError(f"method {method.name}: {call.finding}")
            calls.append(call)
            results.append(result)
            progress()
        return PassResult(opened.record.version or "", opened.idle_bytes, calls, results)
