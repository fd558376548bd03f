"""The record of a call on `<node>/call`: the same to the last bit, and one line for what is not a call."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from sfr_loc_map.errors import InputError
from sfr_loc_map.inputs import Task
from sfr_loc_map.metrics.calls import score_calls
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.runs.call_stats import stats_of
from sfr_loc_map.runs.calls import CallRecord, decode_call, encode_call
from sfr_loc_map.scoring.monitor_score import MonitorScore


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
