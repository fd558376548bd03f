"""Time and memory of all calls of a processing API [4.2.1, 4.2.2, 4.3.1, 4.3.2]."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.metrics.resources import METHOD, METHOD_UNAVAILABLE
from sfr_loc_map.metrics.statistics import summary
from sfr_loc_map.metrics.timing import HOST_CLOCK, SERIES_ROWS, timing_histogram, timing_summary

KINDS = {"mapped": "mapping", "fused": "fusion"}
"""Kind of call by what it said; all other words are those of the localiser."""
STAGE_PREFIX, STAGE_SUFFIX = "stage_", "_s"
"""What surrounds the name of a stage among the figures of a call."""


@dataclass(frozen=True, slots=True, eq=False)
class Calls:
    """Calls in the order they were made.

    Attributes:
        stamps_ns: `(N,)` int64, stamp of the pair.
        seconds: `(N,)` float64, wall-clock time, NaN where not measured.
        states: `(N,)` what each call said: initialising, tracking, lost; mapped, fused.
        peak_bytes: `(N,)` float64, peak resident memory, NaN where not measured.
        above_idle_bytes: `(N,)` float64, the same above the idle process.
        stage_s: `(N,)` float64 by name, time of each stage, NaN where a call had none of that name.
    """

    stamps_ns: IntArray
    seconds: FloatArray
    states: Sequence[str]
    peak_bytes: FloatArray
    above_idle_bytes: FloatArray
    stage_s: Mapping[str, FloatArray] = field(default_factory=dict)


def score_calls(calls: Calls, clock: str = HOST_CLOCK, *, details: bool = True) -> dict[str, Any]:
    """Return the parts `timing`, `memory` and, if wanted, `details` of the score.

    Localisation, mapping (one pair) and fusion are told apart by what the calls said.

    Args:
        calls: All calls.
        clock: Clock of their times.
        details: Whether what figures are drawn from is wanted.
    """
    kinds = np.array([KINDS.get(state, "localisation") for state in calls.states], dtype=object)
    timing: dict[str, Any] = {}
    memory: dict[str, Any] = {}
    drawn: dict[str, Any] = {}
    for kind in ("localisation", "mapping", "fusion"):
        mine = np.flatnonzero(kinds == kind)
        if not len(mine):
            continue
        if np.isfinite(calls.seconds[mine]).any():
            stages = _stages(calls, mine)
            timing[f"{kind}_s"] = timing_summary(calls.seconds[mine], clock) | ({"stages": stages} if stages else {})
        memory |= _peaks(kind, calls, mine)
        if not details:
            continue
        drawn[kind] = {"histogram": timing_histogram(calls.seconds[mine]), "series": _series(calls, mine)}
    known = any(value is not None for value in memory.values())
    memory["method"] = METHOD if known else METHOD_UNAVAILABLE
    return {"timing": timing, "memory": memory} | ({"details": {"calls": drawn}} if details else {})


def score_target(calls: Calls, name: str) -> dict[str, Any]:
    """Return the part `target` of the score: calls that were measured elsewhere, under that place's name.

    They stand apart from the host's figures, and none of both is shown under the other's name.

    Args:
        calls: Calls as measured there.
        name: Name of the target.
    """
    parts = score_calls(calls, clock=name)
    memory = parts["memory"] | {"method": f"as measured on {name}"}
    known = any(isinstance(value, int) for value in memory.values())
    return {"target": {"name": name, "timing": parts["timing"], "memory": memory if known else {}}}


def merge_parts(*parts: Mapping[str, Any]) -> dict[str, Any]:
    """Return parts of a score together; parts of one name are merged, one level down."""
    merged: dict[str, Any] = {}
    for part in parts:
        for name, value in part.items():
            merged[name] = _merged(merged[name], value) if name in merged else value
    return merged


def _merged(first: Mapping[str, Any], second: Mapping[str, Any]) -> dict[str, Any]:
    both = {**first, **second}
    for name in first.keys() & second.keys():
        if isinstance(first[name], Mapping):
            both[name] = {**first[name], **second[name]}
    return both


def stage_of(figure: str) -> str | None:
    """Return the name of the stage whose time a figure of a call is, None if it is none."""
    is_stage = figure.startswith(STAGE_PREFIX) and figure.endswith(STAGE_SUFFIX)
    return figure.removeprefix(STAGE_PREFIX).removesuffix(STAGE_SUFFIX) or None if is_stage else None


def _stages(calls: Calls, mine: IntArray) -> dict[str, Any]:
    """Return the times of the stages over the calls that had them."""
    found = {}
    for name, seconds in sorted(calls.stage_s.items()):
        known = seconds[mine][np.isfinite(seconds[mine])]
        if len(known):
            found[name] = summary(known) | {"max": float(known.max())}
    return found


def _peaks(kind: str, calls: Calls, mine: IntArray) -> dict[str, int | None]:
    peaks = {}
    for name, values in (("peak", calls.peak_bytes[mine]), ("above_idle", calls.above_idle_bytes[mine])):
        known = values[np.isfinite(values)]
        peaks[f"{kind}_{name}_bytes"] = int(known.max()) if len(known) else None
    return peaks


def _series(calls: Calls, mine: IntArray) -> dict[str, Any]:
    """Return the calls for figures; of many calls the slowest of each block, so that no peak is hidden."""
    block = max(1, -(-len(mine) // SERIES_ROWS))
    chosen = []
    for first in range(0, len(mine), block):
        rows = mine[first : first + block]
        chosen.append(rows[np.argmax(np.nan_to_num(calls.seconds[rows], nan=-1.0))])
    return {
        "slowest_of": block,
        "stamp_ns": calls.stamps_ns[chosen].tolist(),
        "processing_time_s": calls.seconds[chosen].tolist(),
        "peak_rss_bytes": calls.peak_bytes[chosen].tolist(),
        "state": [calls.states[row] for row in chosen],
    }
