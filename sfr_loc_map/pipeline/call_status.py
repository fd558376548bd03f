"""One call as the names and texts of a status on /diagnostics. Knows nothing of ROS."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.localisation.estimate import TrackingState
from sfr_loc_map.metrics.config import MappingState
from sfr_loc_map.metrics.consistency import STEP_SIZE
from sfr_loc_map.pipeline.call_record import CallRecord

MAX_CALL_S = 1e6
DEFAULT_STATE = {"localisation": TrackingState.TRACKING.value, "mapping": MappingState.MAPPED.value}
"""State of a call by its task, where a foreign node tells none."""
STATISTIC = "statistic."
"""Prefix of the names of a call's figures."""


@dataclass(frozen=True, slots=True)
class TaskRecord:
    """A call and the task it belongs to.

    Attributes:
        task: `localisation` or `mapping`.
        record: The call.
        memory_method: How the memory was measured.
    """

    task: str
    record: CallRecord
    memory_method: str


def call_of(values: Mapping[str, str]) -> TaskRecord | None:
    """Return the call that the values of a status describe, None where they describe something else.

    Raises:
        InputError: If they do, but one is missing or no number.
    """
    if "task" not in values or "processing_time_s" not in values:
        return None
    try:
        statistics = {
            name.removeprefix(STATISTIC): float(text) for name, text in values.items() if name.startswith(STATISTIC)
        }
        record = CallRecord(
            stamp_ns=_whole(values, "stamp_ns"),
            processing_time_s=_seconds(values["processing_time_s"]),
            state=values.get("state") or DEFAULT_STATE[values["task"]],
            peak_rss_bytes=_optional(values, "peak_rss_bytes"),
            above_idle_bytes=_optional(values, "above_idle_bytes"),
            statistics=statistics,
            reason=values.get("reason", ""),
            step=_step(values.get("step", "")),
        )
    except (KeyError, ValueError) as error:
        raise InputError(str(error)) from error
    return TaskRecord(values["task"], record, values.get("memory_method", ""))


def _step(text: str) -> FloatArray | None:
    numbers = np.array([float(word) for word in text.split()[: STEP_SIZE + 1]])
    return numbers if len(numbers) == STEP_SIZE and np.isfinite(numbers).all() else None


def _optional(values: Mapping[str, str], name: str) -> int | None:
    return _whole(values, name) if name in values else None


def _whole(values: Mapping[str, str], name: str) -> int:
    number = int(values[name])
    if not 0 <= number < 2**63:  # what arrays of whole numbers can hold
        raise ValueError(f"{name} is out of range")
    return number


def _seconds(text: str) -> float:
    seconds = float(text)
    if not 0.0 <= seconds <= MAX_CALL_S:
        raise ValueError(f"a call of {seconds} s")
    return seconds
