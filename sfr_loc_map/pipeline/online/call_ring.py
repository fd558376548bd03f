"""The last calls of the nodes, in bounded memory."""

from __future__ import annotations

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.metrics.calls import Calls, stage_of
from sfr_loc_map.pipeline.call_record import CallRecord

MAX_STATES, MAX_STAGES = 100, 16
"""States that are told apart, and stages whose times are kept: their names come from the network."""


class CallRing:
    """The last calls, in arrays allocated at the start: memory does not grow over a long run."""

    def __init__(self, capacity: int) -> None:
        """Allocate for so many calls."""
        # seconds, peak, above idle; filled, so that the memory is resident from now on
        self._figures = np.full((3, capacity), np.nan)
        self._stamps_ns, self._states = np.full(capacity, -1, np.int64), np.full(capacity, -1, np.int16)
        self._names: list[str] = []
        self._stages: dict[str, FloatArray] = {}
        self._added = 0

    def __len__(self) -> int:
        """Return how many are kept."""
        return min(self._added, len(self._states))

    def add(self, record: CallRecord) -> None:
        """Add a call; the oldest is dropped if the ring is full."""
        row = self._added % len(self._states)
        self._stamps_ns[row], self._states[row] = record.stamp_ns, self._state(record.state)
        peaks = (np.nan if value is None else value for value in (record.peak_rss_bytes, record.above_idle_bytes))
        self._figures[:, row] = (record.processing_time_s, *peaks)
        for seconds in self._stages.values():
            seconds[row] = np.nan
        for figure, value in record.statistics.items():
            if (name := stage_of(figure)) and (column := self._stage(name)) is not None:
                column[row] = value
        self._added += 1

    def clear(self) -> None:
        """Forget all calls."""
        self._added = 0
        self._stages.clear()

    def calls(self) -> Calls:
        """Return them in the order in which they were added."""
        order = np.arange(self._added - len(self), self._added) % len(self._states)
        seconds, peak, above = self._figures[:, order]
        names = np.array(self._names, object)
        stages = {name: kept[order] for name, kept in self._stages.items()}
        return Calls(self._stamps_ns[order], seconds, names[self._states[order]].tolist(), peak, above, stages)

    def _stage(self, name: str) -> FloatArray | None:
        """Return the times of a stage, None if there are too many stages."""
        if name not in self._stages and len(self._stages) < MAX_STAGES:
            self._stages[name] = np.full(len(self._states), np.nan)
        return self._stages.get(name)

    def _state(self, name: str) -> int:
        """Return the number of a state; the words come from the network, so their number is limited."""
        if name not in self._names:
            if len(self._names) == MAX_STATES:
                return MAX_STATES - 1
            self._names.append(name)
        return self._names.index(name)
