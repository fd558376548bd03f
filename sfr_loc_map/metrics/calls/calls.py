"""The calls of a processing API as columns: kinds and states of calls, and the statistics that a call may have."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray, Mask
from sfr_loc_map.message_text import counted, printable
from sfr_loc_map.metrics.config import CallKind, MappingState
from sfr_loc_map.metrics.figures.row_part import AFTER_FIRST, FIRST, RowPart
from sfr_loc_map.suite_names import Task

STATE_KINDS: dict[str, CallKind] = {
    MappingState.MAPPED: CallKind.MAPPING,
    MappingState.FUSED: CallKind.FUSION,
    MappingState.MAPPED_SET: CallKind.MAPPING_CALL,
}
"""Kind of a mapping call by its state."""
LOCALISER_STATES = ("", "initialising", "tracking", "degraded", "lost")
"""States of a call of a localiser; empty for an unknown state (`localisation.estimate.TrackingState`)."""
KNOWN_STATES = (*LOCALISER_STATES, *STATE_KINDS)
KINDS_OF = {task: tuple(kind for kind in CallKind if kind.task is task) for task in Task}
"""Kinds of calls by their task."""
USAGE_NAMES = ("cpu_s", "cpu_between_s", "threads", "processes")
"""Statistics of a call that state the usage of a method, measured from outside its processes."""
MAX_NUMBER = 1e18
"""Maximum magnitude of times, sizes, covariances and statistics of calls. Its square is finite."""


@dataclass(frozen=True, slots=True, eq=False)
class Calls:
    """The calls of a run, in the order of their files and chronologically within a file."""

    stamps_ns: IntArray  #: `(N,)` int64, stamp of the pair.
    seconds: FloatArray  #: `(N,)` float64, wall-clock time, NaN if not measured.
    states: Sequence[str]  #: `(N,)` state of each call: initialising, tracking, degraded, lost; mapped, fused.
    peak_bytes: FloatArray  #: `(N,)` float64, peak resident memory, NaN if not measured.
    above_idle_bytes: FloatArray  #: `(N,)` float64, peak resident memory above the idle process, NaN if not measured.
    #: `(N,)` float64 by the name of the stage: time of the stage, NaN if the call does not have the stage.
    stage_s: Mapping[str, FloatArray] = field(default_factory=dict)
    heap_bytes: FloatArray | None = None  #: `(N,)` peak heap size, NaN if not measured; None if never measured.
    stack_bytes: FloatArray | None = None  #: `(N,)` peak stack depth, NaN if not measured; None if never measured.
    memory_method: str | None = None  #: Method of measuring memory, from the source of the calls; None if unknown.

    def __post_init__(self) -> None:
        """Check that each column has one entry for each call; MetricsError if not.

        MetricsError also if a state is unknown, or if a number is negative or infinite.
        """
        count = len(self.stamps_ns)
        if len(self.states) != count:
            raise MetricsError(f"{counted(count, 'call')} have {len(self.states)} states: one state each is required")
        for state in sorted(set(self.states).difference(KNOWN_STATES)):
            needed = f"one of {', '.join(filter(None, KNOWN_STATES))}, or an empty text, is required"
            raise MetricsError(f"the state of a call is '{state}': {needed}")
        names = ("seconds", "peak_bytes", "above_idle_bytes", "heap_bytes", "stack_bytes")
        columns = {name: getattr(self, name) for name in names}
        columns |= {f"stage_s[{name}]": seconds for name, seconds in self.stage_s.items()}
        for name, values in columns.items():
            if values is None:
                continue
            if np.shape(values) != (count,):
                needed = f"{(count,)} is required for {counted(count, 'call')}"
                raise MetricsError(f"'{name}' of calls has the shape {np.shape(values)}: {needed}")
            is_invalid = (values < 0.0) | np.isinf(values)
            if is_invalid.any():
                invalid = values[np.argmax(is_invalid)]
                raise MetricsError(f"'{name}' of a call is {invalid:g}: a finite number >= 0, or NaN, is required")

    @property
    def kinds(self) -> NDArray[np.object_]:
        """Kind `(N,)` of each call."""
        return np.array([STATE_KINDS.get(state, CallKind.LOCALISATION) for state in self.states], dtype=object)

    @property
    def is_localisation(self) -> Mask:
        """Whether each call `(N,)` is a call of a localiser."""
        return np.asarray(self.kinds == CallKind.LOCALISATION, np.bool_)


def concatenated(parts: Sequence[Calls]) -> Calls:
    """Return the calls of one or several files as calls of one run, in the order of the files."""
    counts = [len(part.stamps_ns) for part in parts]
    stages = dict.fromkeys(name for part in parts for name in part.stage_s)
    stage_s = {name: stacked([part.stage_s.get(name) for part in parts], counts) for name in stages}
    return Calls(
        np.concatenate([part.stamps_ns for part in parts]),
        np.concatenate([part.seconds for part in parts]),
        [state for part in parts for state in part.states],
        np.concatenate([part.peak_bytes for part in parts]),
        np.concatenate([part.above_idle_bytes for part in parts]),
        {name: values for name, values in stage_s.items() if values is not None},
        stacked([part.heap_bytes for part in parts], counts),
        stacked([part.stack_bytes for part in parts], counts),
        memory_method="; ".join(dict.fromkeys(part.memory_method for part in parts if part.memory_method)) or None,
    )


def stacked(parts: Sequence[FloatArray | None], counts: Sequence[int]) -> FloatArray | None:
    """Return the concatenated values of several files, NaN for a file without them; None if no file has them."""
    shape = next((part.shape[1:] for part in parts if part is not None), None)
    if shape is None:
        return None
    return np.concatenate(
        [np.full((count, *shape), np.nan) if part is None else part for part, count in zip(parts, counts, strict=True)]
    )


# ---- statistics of a call


def statistic_range(name: str) -> tuple[float, float]:
    """Return the lowest and highest valid number of a statistic of a call. Times of stages and usage are at least 0."""
    is_unsigned = stage_of(name) is not None or name in USAGE_NAMES
    return 0.0 if is_unsigned else -MAX_NUMBER, MAX_NUMBER


def is_statistic(name: str, value: float) -> bool:
    """Return whether a number is valid for a statistic of a call; the name must be printable."""
    low, high = statistic_range(name)
    return low <= value <= high and printable(name) == name


def stage_of(figure: str) -> str | None:
    """Return NAME for a figure `stage_NAME_s`, the time of a stage of a call; None for other figures.

    The name is in quotes if the name has a different meaning as a part of a row, such as `target` or `first call`.
    """
    found = re.fullmatch(r"stage_(.+)_s", figure)
    if found is None:
        return None
    name = found[1]
    is_reserved = name in (FIRST, AFTER_FIRST) or RowPart(name).what != name
    return f"'{name}'" if is_reserved else name
