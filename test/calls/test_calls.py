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
from msgspec.structs import replace

from sfr_loc_map.calls.call_files import COVARIANCE_NAMES, load_call_stats, save_stats
from sfr_loc_map.calls.call_record import CallRecord, decode_call, encode_call
from sfr_loc_map.calls.call_stats import USAGE_NAMES, CallStats, stats_of
from sfr_loc_map.errors import InputError
from sfr_loc_map.metrics.calls.call_score import STATED_CLOCK, score_calls
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.metrics.judging.limits_file import parse_limits
from sfr_loc_map.metrics.table.records import MethodKind, MethodRecord
from sfr_loc_map.scoring.live.monitor_score import MonitorScore
from sfr_loc_map.scoring.live.received_rows import CallRows
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
        (half := rng.normal(size=(6, 6)) / 3.0) @ half.T,
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


def test_what_is_unknown_in_a_call_is_unknown_when_read_back() -> None:
    unknown = np.full((6, 6), np.nan)
    record = CallRecord(5, math.nan, "tracking", None, None, {"a": math.inf}, unknown, times={"b": math.nan, "c": 1.0})
    found = decode_call(encode_call(record), Task.LOCALISATION)
    assert math.isnan(found.processing_time_s)
    assert (found.statistics, found.times, found.covariance) == ({}, {"c": 1.0}, None)


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
        st.sampled_from(["inliers", *(f"stage_{number}_s" for number in range(20)), *USAGE_NAMES, "state"]),
        st.floats(0.0, 9.0),
    ),
    optional(arrays_of(6, 6).map(lambda half: half @ half.T)),
    st.sampled_from(["", "few_landmarks"]),
    optional(arrays_of(48)),
    st.sampled_from(["", "crashed: ended, with code 3", "missing answer: none"]),
)
METHOD = MethodRecord(name="x", version="1", kind=MethodKind.EXTERNAL)


def assert_same_calls(found: CallStats, made: CallStats, *, is_stated: bool = False) -> None:
    for name in ("covariance", "steps", "method", "findings", "positions", "has_stamps"):
        np.testing.assert_array_equal(getattr(found, name), getattr(made, name), name)
    method = {"method": STATED_CLOCK} if is_stated else {}
    assert found.processes == (None if made.processes is None else replace(made.processes, **method))
    for name in ("stamps_ns", "seconds", "states", "peak_bytes", "above_idle_bytes"):
        np.testing.assert_array_equal(getattr(found.calls, name), getattr(made.calls, name), name)
    assert found.calls.stage_s.keys() == made.calls.stage_s.keys()
    for name, times in found.calls.stage_s.items():
        np.testing.assert_array_equal(times, made.calls.stage_s[name], name)


@given(st.lists(RECORDS, min_size=1, max_size=4), st.sampled_from([None, METHOD]))
def test_the_file_of_the_calls_and_their_messages_have_what_the_records_have(
    records: list[CallRecord], method: MethodRecord | None
) -> None:
    with tempfile.TemporaryDirectory() as folder:
        save_stats(Path(folder) / "s.csv", records, {} if method is None else {Task.LOCALISATION: method})
        read, made = load_call_stats(Path(folder) / "s.csv"), stats_of(records, method)
    assert_same_calls(read, made)
    assert read.calls.memory_method == made.calls.memory_method
    received = CallRows()
    for record in records:
        received.add_call(record)
    live = received.stats()
    assert live is not None
    assert_same_calls(live, stats_of(records), is_stated=True)
    is_measured = any(record.peak_rss_bytes is not None for record in records)
    assert live.calls.memory_method == (STATED_CLOCK if is_measured else None)


def test_a_crash_that_a_call_states_fails_a_live_score() -> None:
    monitor = MonitorScore(ScoreConfig(), parse_limits({"timing": {"localisation_max_s": 1.0}}, "limits"))
    for stamp_ns in range(1, 601):
        monitor.add_call(CallRecord(stamp_ns, 0.1, "tracking"))
    assert monitor.result().verdict != "fail"
    monitor.add_call(CallRecord(601, 0.1, "tracking", finding="crashed: dead"))
    score = monitor.result()
    assert score.verdict == "fail"
    assert [(item.kind, item.count, item.text) for item in score.findings] == [("crashed", 1, "dead")]


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
        f'{{"stamp_ns": 5, "processing_time_s": 1, "covariance": {(-np.eye(6)).tolist()}}}',
        f'{{"stamp_ns": 5, "processing_time_s": 1, "step": {["1"] * 48}}}'.replace("'", '"'),
        f'{{"stamp_ns": 5, "processing_time_s": 1, "step": {[True] * 48}}}'.lower(),
        '{"stamp_ns": 5, "processing_time_s": 1, "peak_rss_bytes": -1}',
        '{"stamp_ns": 5, "processing_time_s": 1, "statistics": {"x": "y"}}',
        '{"stamp_ns": 5, "processing_time_s": 1, "reason": "' + "x" * 2_000_000 + '"}',
    ],
)
def test_what_is_not_a_call_is_refused_in_one_line(text: str) -> None:
    with pytest.raises(InputError) as refused:
        decode_call(text, Task.LOCALISATION)
    assert len(str(refused.value).splitlines()) == 1


def test_a_table_with_more_cells_than_columns_is_refused_by_its_columns(tmp_path: Path) -> None:
    (tmp_path / "calls.csv").write_text("a,b\n1,2,3\n")
    with pytest.raises(InputError, match="the columns are a, b:"):
        load_call_stats(tmp_path / "calls.csv")


@pytest.mark.parametrize(
    ("columns", "row", "words"),
    [
        ("processing_time_s", "0,05", "line 3: 3 cells for 2 columns"),
        ("processing_time_s,state", "0.05", "line 3: 2 cells for 3 columns"),
        ("processing_time_s,processing_time_s", "1,2", "line 1: column processing_time_s is given 2 times"),
        ("processing_time_s", "1_0", "line 3: processing_time_s is '1_0'"),
        (",".join(COVARIANCE_NAMES), ",".join(["-1", *20 * ["0"]]), "line 3: a variance of 'covariance' is -1"),
    ],
)
def test_a_cell_that_may_be_misread_is_refused_with_its_line(
    tmp_path: Path, columns: str, row: str, words: str
) -> None:
    (tmp_path / "calls.csv").write_text(f"stamp_ns,{columns}\n\n5,{row}\n")
    with pytest.raises(InputError, match=words):
        load_call_stats(tmp_path / "calls.csv")


def test_a_stamp_that_is_no_integer_is_refused_with_its_line(tmp_path: Path) -> None:
    (tmp_path / "calls.csv").write_text("stamp_ns,state\n5,tracking\n6.5,lost\n")
    with pytest.raises(InputError, match=r"line 3: stamp '6\.5' is not an integer"):
        load_call_stats(tmp_path / "calls.csv")
