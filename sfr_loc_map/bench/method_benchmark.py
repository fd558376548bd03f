"""Comparison of several methods on the same pairs: accuracy, time and memory.

In each pass, one method at a time processes all pairs, so that the times of the methods can be compared. The jobs of a
suite, in contrast, run concurrently. Figures are medians over the passes.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from sfr_loc_map.bench.figure_rows import FigureRow, medians, nested, ratios
from sfr_loc_map.bench.passes import PassResult, run_pass
from sfr_loc_map.bench.provenance import SCHEMA, provenance
from sfr_loc_map.bench.trials import Item, Opened, Result, Trial
from sfr_loc_map.errors import MethodError
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.methods.registry import BUILT_IN, OURS_IN_TABLES, PEERS, Method, find_method, find_peer
from sfr_loc_map.signals import hold
from sfr_loc_map.suite_names import Task


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
