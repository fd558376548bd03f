"""The record of a call as JSON, which a node publishes on `<node>/call`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import msgspec
import numpy as np

from sfr_loc_map.calls.call_record import (
    DEFAULT_STATE,
    STATES_OF,
    UNKNOWN_TIME_S,
    CallRecord,
    bounded,
    check_uncertainty,
)
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.inputs import MAX_TEXT_BYTES, refusing
from sfr_loc_map.message_text import printable
from sfr_loc_map.metrics.calls.calls import MAX_NUMBER, is_statistic, statistic_range
from sfr_loc_map.metrics.frames.covariance import STEP_SIZE
from sfr_loc_map.suite_names import Task

MAX_STATISTICS = 500  #: Maximum number of statistics of a received call; each has a column in the file of the calls.


def encode_call(record: CallRecord) -> str:
    """Return a call as JSON; numbers have the shortest form that is exact when read back.

    JSON has no NaN: an unknown processing time is `UNKNOWN_TIME_S`, and other unknown values are omitted, as are
    statistics that `decode_call` would refuse. Covariance and step are bounded as in the file of the calls.
    """
    finite = replace(
        record,
        statistics={name: float(value) for name, value in record.statistics.items() if is_statistic(name, value)},
        times={name: float(value) for name, value in record.times.items() if math.isfinite(value)},
        covariance=_bounded_or_none(record.covariance),
        step=_bounded_or_none(record.step),
    )
    content = msgspec.to_builtins(finite, enc_hook=_to_plain) | {"task": record.task}
    if record.processing_time_s is None:
        content["processing_time_s"] = UNKNOWN_TIME_S
    return msgspec.json.encode(content).decode()


def _bounded_or_none(values: FloatArray | None) -> FloatArray | None:
    return None if values is None or np.isnan(values).any() else bounded(values)


def decode_call(text: str, task: Task) -> CallRecord:
    """Return the call in the JSON of a node; `task` is the task of the topic, and determines the default state.

    Unknown keys are ignored. InputError if a key is missing or a value has another type or range.
    """
    with refusing(f"call of {task}", "publish a JSON object with stamp_ns and processing_time_s for each call"):
        if len(text) > MAX_TEXT_BYTES:
            raise ValueError(f"{len(text)} characters: at most {MAX_TEXT_BYTES} are allowed")
        content = msgspec.json.decode(text, type=dict[str, Any])
        stated_task = content.get("task", task)
        if stated_task != task:
            raise ValueError(f"task is {stated_task!r:.40}: '{task}' is required on this topic")
        if content.get("processing_time_s", UNKNOWN_TIME_S) is None:
            raise ValueError("'processing_time_s' is null: a number of seconds is required, 0 if it is unknown")
        record = msgspec.convert(content, CallRecord, dec_hook=_from_plain)
        state = record.state or DEFAULT_STATE[task]
        if state not in STATES_OF[task]:
            known = ", ".join(filter(None, STATES_OF[task]))
            raise ValueError(f"state is '{state}': one of {known} is required")
        if len(set(record.pair_stamps_ns)) < len(record.pair_stamps_ns):
            raise ValueError("'pair_stamps_ns' contains a stamp twice: each pair is required once")
        _check_statistics(record.statistics)
        if record.step is not None:
            _check_array("step", record.step, (STEP_SIZE,))
        if record.covariance is not None:
            _check_array("covariance", record.covariance, (6, 6))
        check_uncertainty(record)
    seconds = None if record.processing_time_s == UNKNOWN_TIME_S else record.processing_time_s
    return replace(record, processing_time_s=seconds, state=state)


def _check_statistics(statistics: Mapping[str, float]) -> None:
    """Raise ValueError if there are too many statistics, or if a name is not printable or a number out of range."""
    if len(statistics) > MAX_STATISTICS:
        raise ValueError(f"{len(statistics)} statistics: at most {MAX_STATISTICS} are allowed")
    for name, value in statistics.items():
        if not is_statistic(name, value):
            low, high = statistic_range(name)
            required = f"a printable name and {low:g} to {high:g} are required"
            raise ValueError(f"statistic '{printable(name)}' is {value:g}: {required}")


def _check_array(name: str, values: FloatArray, shape: tuple[int, ...]) -> None:
    """Raise ValueError if an array does not have the given shape, or contains a number beyond `MAX_NUMBER`."""
    if values.shape != shape:
        raise ValueError(f"'{name}' has the shape {values.shape}: {shape} is required")
    largest = np.abs(values).max()
    if not largest <= MAX_NUMBER:
        raise ValueError(f"'{name}' contains the number {largest:g}: at most {MAX_NUMBER:g} is allowed")


def _to_plain(value: Any) -> Any:  # noqa: ANN401 - an array or a number of NumPy
    return value.tolist()


def _from_plain(kind: type[Any], value: Any) -> FloatArray:  # noqa: ANN401 - JSON
    numbers = np.array(value)
    if numbers.dtype.kind not in "if":
        raise ValueError(f"an array has {numbers.dtype.name} values: numbers are required")
    return numbers.astype(np.float64)
