"""The record of a call on `<node>/call`: the same to the last bit, and one line for what is not a call."""

from __future__ import annotations

import math
import tempfile
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfr_loc_map.calls.call_files import load_call_stats, save_stats
from sfr_loc_map.calls.call_record import CallRecord, decode_call, encode_call
from sfr_loc_map.calls.call_stats import stats_of
from sfr_loc_map.errors import InputError
from sfr_loc_map.metrics.calls.call_score import score_calls
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.metrics.table.records import MethodKind, MethodRecord
from sfr_loc_map.scoring.live.monitor_score import MonitorScore
from sfr_loc_map.suite_names import Task


def test_a_call_comes_back_to_the_last_bit() -> None:
    rng = np.random.default_rng(0)
    record = CallRecord(
        1_700_000_000_123_456_789,
        0.1 + 0.2,
        "fused",
        123456789,
        1000,
        {"inliers": np.float64(1 / 3), "unknown": np.nan},
        rng.normal(size=(6, 6)) / 3.0,
        "few_landmarks",
        rng.normal(size=48) / 3.0,
        "late: 3 s",
        (1, 2, 3),
        True,
        {"conversion_s": 1 / 7},
        {"dropped_stale": 4},
        "1.0",
        task=Task.MAPPING,
    )
    found = decode_call(encode_call(record), Task.MAPPING)
    for name in (field.name for field in fields(CallRecord)):
        if name != "statistics":
            np.testing.assert_array_equal(getattr(found, name), getattr(record, name), strict=False)
    assert found.statistics == {"inliers": 1 / 3}


def optional(values: st.SearchStrategy[object]) -> st.SearchStrategy[object]:
    return st.none() | values


def arrays_of(*shape: int) -> st.SearchStrategy[object]:
    return st.integers(0, 99).map(lambda seed: np.random.default_rng(seed).normal(size=shape) / 3.0)


RECORDS = st.builds(
    CallRecord,
    st.integers(0, 2**62 - 1),
    st.floats(0.0, 1e6) | st.just(math.nan),
    st.sampled_from(["tracking", "lost", "degraded", ""]),
    optional(st.integers(0, 2**53)),
    optional(st.integers(0, 2**53)),
    st.dictionaries(
        st.sampled_from(["inliers", "stage_fuse_s", "cpu_s", "cpu_between_s", "state"]), st.floats(0.0, 9.0)
    ),
    optional(arrays_of(6, 6).map(lambda half: half @ half.T)),
    st.sampled_from(["", "few_landmarks"]),
    optional(arrays_of(48)),
    st.sampled_from(["", "crashed: ended, with code 3", "missing answer: none"]),
)
METHOD = MethodRecord(name="x", version="1", kind=MethodKind.EXTERNAL)


@given(st.lists(RECORDS, min_size=1, max_size=4), st.sampled_from([None, METHOD]))
def test_the_file_of_the_calls_has_what_the_records_have(
    records: list[CallRecord], method: MethodRecord | None
) -> None:
    with tempfile.TemporaryDirectory() as folder:
        save_stats(Path(folder) / "s.csv", records, method)
        read, made = load_call_stats(Path(folder) / "s.csv"), stats_of(records, method)
    for name in ("covariance", "steps", "method", "findings", "processes", "positions", "has_stamps"):
        np.testing.assert_array_equal(getattr(read, name), getattr(made, name), name)
    for name in ("stamps_ns", "seconds", "states", "peak_bytes", "above_idle_bytes", "memory_method"):
        np.testing.assert_array_equal(getattr(read.calls, name), getattr(made.calls, name), name)
    assert read.calls.stage_s.keys() == made.calls.stage_s.keys()
    for name, times in read.calls.stage_s.items():
        np.testing.assert_array_equal(times, made.calls.stage_s[name], name)


def test_a_node_of_anyone_states_a_stamp_and_a_time() -> None:
    """The state of a localiser that reports none is unknown: lost poses cannot be counted by a guess."""
    text = '{"stamp_ns": 5, "processing_time_s": 0.25, "colour": "red"}'
    assert decode_call(text, Task.LOCALISATION).state == ""
    assert decode_call(text, Task.MAPPING).state == "mapped"
    assert [decode_call(text, task).task for task in Task] == list(Task)


def test_a_time_of_0_is_unknown_in_a_live_score_as_in_a_file() -> None:
    calls = [decode_call(f'{{"stamp_ns": {stamp}, "processing_time_s": 0}}', Task.LOCALISATION) for stamp in (1, 2)]
    monitor = MonitorScore(ScoreConfig(), None)
    for call in calls:
        monitor.add_call(call)
    of_file = score_calls(stats_of(calls).calls).figures
    assert monitor.result().figures[: len(of_file)] == of_file


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        '{"stamp_ns": 5}',
        '{"stamp_ns": -1, "processing_time_s": 1}',
        '{"stamp_ns": 99999999999999999999, "processing_time_s": 1}',
        '{"stamp_ns": 5, "processing_time_s": NaN}',
        '{"stamp_ns": 5, "processing_time_s": 1e7}',
        '{"stamp_ns": 5, "processing_time_s": 1, "state": "cooking"}',
        '{"stamp_ns": 5, "processing_time_s": 1, "state": "mapped"}',
        '{"stamp_ns": 5, "processing_time_s": 1, "task": "mapping"}',
        '{"stamp_ns": 5, "processing_time_s": 1, "task": "cooking"}',
        '{"stamp_ns": 5, "processing_time_s": 1, "step": [1.0]}',
        '{"stamp_ns": 5, "processing_time_s": 1, "covariance": [[1e999]]}',
        '{"stamp_ns": 5, "processing_time_s": 1, "peak_rss_bytes": -1}',
        '{"stamp_ns": 5, "processing_time_s": 1, "statistics": {"x": "y"}}',
        '{"stamp_ns": 5, "processing_time_s": 1, "reason": "' + "x" * 2_000_000 + '"}',
    ],
)
def test_what_is_not_a_call_is_refused_in_one_line(text: str) -> None:
    with pytest.raises(InputError) as refused:
        decode_call(text, Task.LOCALISATION)
    assert len(str(refused.value).splitlines()) == 1
