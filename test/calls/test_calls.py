"""The record of a call on `<node>/call`: the same to the last bit, and one line for what is not a call."""

from __future__ import annotations

import json
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
from sfr_loc_map.calls.call_message import decode_call, encode_call
from sfr_loc_map.calls.call_poses import estimates_of
from sfr_loc_map.calls.call_record import CallRecord, tracking_warning
from sfr_loc_map.calls.call_stats import CallStats
from sfr_loc_map.calls.growing_calls import GrowingCalls, stats_of
from sfr_loc_map.errors import InputError
from sfr_loc_map.io.stamps.stamp_text import STAMP_LIMIT
from sfr_loc_map.message_text import printable
from sfr_loc_map.metrics.calls.call_meter import HOST_CLOCK, METHOD
from sfr_loc_map.metrics.calls.call_score import STATED_BY_NODE, score_calls
from sfr_loc_map.metrics.calls.calls import MAX_NUMBER, USAGE_NAMES
from sfr_loc_map.metrics.config import CallKind, ScoreConfig
from sfr_loc_map.metrics.figures.records import FindingKind, FindingRecord, MethodKind, MethodRecord
from sfr_loc_map.metrics.frames.covariance import UPPER
from sfr_loc_map.metrics.judging.limits_file import parse_limits
from sfr_loc_map.replay.message_store import ReceivedDrive
from sfr_loc_map.scoring.inputs import Run
from sfr_loc_map.scoring.live.monitor_score import MonitorScore
from sfr_loc_map.scoring.results import calls_result
from sfr_loc_map.suite_names import Task


def test_a_call_comes_back_to_the_last_bit() -> None:
    rng = np.random.default_rng(0)
    record = CallRecord(
        1_700_000_000_123_456_789,
        0.1 + 0.2,
        "fused",
        peak_rss_bytes=123456789,
        above_idle_bytes=1000,
        statistics={"inliers": np.float64(1 / 3), "unknown": np.nan},
        covariance=(half := rng.normal(size=(6, 6)) / 3.0) @ half.T,
        reason="few_landmarks",
        step=np.abs(rng.normal(size=48)) / 3.0,
        finding="late: 3 s",
        pair_stamps_ns=(1, 2, 3),
        fused=True,
        times={"conversion_s": 1 / 7},
        counts={"dropped_stale": 4},
        version="1.0",
    )
    found = decode_call(encode_call(record), Task.MAPPING)
    for name in (field.name for field in fields(CallRecord)):
        if name != "statistics":
            np.testing.assert_array_equal(getattr(found, name), getattr(record, name), strict=False)
    assert found.statistics == {"inliers": 1 / 3}


@pytest.mark.parametrize("variance", [1e30, math.inf])
def test_an_uncertainty_beyond_the_largest_number_is_equal_in_a_message_and_in_a_file(
    tmp_path: Path, variance: float
) -> None:
    covariance = np.where(np.eye(6) > 0.0, variance, 0.0)
    record = CallRecord(5, 0.1, "lost", covariance=covariance, step=np.full(48, variance))
    found = decode_call(encode_call(record), Task.LOCALISATION)
    save_stats(tmp_path / "s.csv", [record])
    of_file = load_call_stats(tmp_path / "s.csv")
    assert found.covariance is not None
    assert of_file.covariance is not None
    assert of_file.steps is not None
    np.testing.assert_array_equal(found.covariance, MAX_NUMBER * np.eye(6))
    np.testing.assert_array_equal(of_file.covariance[0], found.covariance[np.triu_indices(6)])
    np.testing.assert_array_equal(of_file.steps[0], found.step)


def test_what_is_unknown_in_a_call_is_unknown_when_read_back() -> None:
    unknown = np.full((6, 6), np.nan)
    record = CallRecord(
        5, None, "tracking", statistics={"a": math.inf, "b": 1e19}, covariance=unknown, times={"b": math.nan, "c": 1.0}
    )
    found = decode_call(encode_call(record), Task.LOCALISATION)
    assert found.processing_time_s is None
    assert (found.statistics, found.times, found.covariance) == ({}, {"c": 1.0}, None)


def optional(values: st.SearchStrategy[object]) -> st.SearchStrategy[object]:
    return st.none() | values


def arrays_of(*shape: int) -> st.SearchStrategy[object]:
    return st.integers(0, 99).map(lambda seed: np.random.default_rng(seed).normal(size=shape) / 3.0)


STAGES = [f"stage_{number}_s" for number in range(20)]
RECORDS = st.builds(
    CallRecord,
    st.integers(0, 2**62 - 1),
    optional(st.floats(0.0, 1e6, exclude_min=True) | st.floats(0.0, 9.0, exclude_min=True).map(np.float64)),
    st.sampled_from(["tracking", "lost", "degraded", ""]),
    peak_rss_bytes=optional(st.integers(0, 2**53)),
    above_idle_bytes=optional(st.integers(0, 2**53)),
    statistics=st.dictionaries(
        st.sampled_from(["inliers", *STAGES, *USAGE_NAMES, "state", "statistics.state", "statistics.", ""]),
        st.floats(0.0, 9.0) | st.floats(0.0, 9.0).map(np.float64),
    ),
    covariance=optional(arrays_of(6, 6).map(lambda half: half @ half.T)),
    reason=st.sampled_from(["", "few_landmarks", "line\rof\nlines", "zero\0"]),
    step=optional(arrays_of(48).map(np.abs)),
    finding=st.sampled_from(["", "crashed: ended, with code 3", "missing answer: none"]),
)
METHODS = [None, *(MethodRecord(name="x", version="1", kind=kind) for kind in (MethodKind.EXTERNAL, MethodKind.PYTHON))]


def assert_same_calls(found: CallStats, made: CallStats, *, is_stated: bool = False) -> None:
    for name in ("covariance", "steps", "method", "findings", "has_stamps"):
        np.testing.assert_array_equal(getattr(found, name), getattr(made, name), name)
    method = {"method": STATED_BY_NODE} if is_stated else {}
    assert found.processes == (None if made.processes is None else replace(made.processes, **method))
    for name in ("stamps_ns", "seconds", "states", "peak_bytes", "above_idle_bytes"):
        np.testing.assert_array_equal(getattr(found.calls, name), getattr(made.calls, name), name)
    assert found.calls.stage_s.keys() == made.calls.stage_s.keys()
    for name, times in found.calls.stage_s.items():
        np.testing.assert_array_equal(times, made.calls.stage_s[name], name)


@given(st.lists(RECORDS, min_size=1, max_size=4), st.sampled_from(METHODS))
def test_the_file_of_the_calls_and_their_messages_have_what_the_records_have(
    records: list[CallRecord], method: MethodRecord | None
) -> None:
    with tempfile.TemporaryDirectory() as folder:
        save_stats(Path(folder) / "s.csv", records, {} if method is None else {Task.LOCALISATION: method})
        read = load_call_stats(Path(folder) / "s.csv")
    is_external = method is not None and method.kind is MethodKind.EXTERNAL
    assert_same_calls(read, stats_of(records, method), is_stated=is_external)
    has_memory = any(record.peak_rss_bytes is not None for record in records)
    assert read.stated_tasks == (frozenset({Task.LOCALISATION}) if is_external else frozenset())
    assert read.calls.memory_method == ((STATED_BY_NODE if is_external else METHOD) if has_memory else None)
    received = GrowingCalls()
    for record in records:
        received.add(record)
    live = received.stats(stated_tasks=tuple(Task))
    assert live is not None
    assert_same_calls(live, stats_of(records), is_stated=True)
    assert live.calls.memory_method == (STATED_BY_NODE if has_memory else None)


def test_the_memory_of_an_external_mapper_is_stated_and_that_of_our_localiser_measured(tmp_path: Path) -> None:
    records = [CallRecord(1, 0.1, "tracking", peak_rss_bytes=5), CallRecord(1, 0.2, "mapped", peak_rss_bytes=6)]
    theirs = MethodRecord(name="x", version="1", kind=MethodKind.EXTERNAL)
    save_stats(tmp_path / "s.csv", records[::-1], {Task.MAPPING: theirs})
    read, made = load_call_stats(tmp_path / "s.csv"), stats_of(records, stated_tasks=(Task.MAPPING,))
    assert read.calls.memory_method == made.calls.memory_method == f"{METHOD}; {STATED_BY_NODE}"
    calls = calls_result(Run(stats=[read]), {}, details=False)
    assert calls.records is not None
    assert calls.records.clocks == {CallKind.LOCALISATION: HOST_CLOCK, CallKind.MAPPING: STATED_BY_NODE}


@pytest.mark.parametrize("text", ["1.0\r2", "1.0\n2", "1\0", "\ud800", "a, 'b' \"c\""])
def test_the_texts_of_a_node_do_not_break_the_rows_of_a_file(tmp_path: Path, text: str) -> None:
    """Version, reason and findings of an external node come from its messages and from the output of its process."""
    record = CallRecord(1, 0.1, "lost", reason=text, finding=f"{FindingKind.LATE}: {text}")
    method = MethodRecord(name="x", version=text, kind=MethodKind.EXTERNAL)
    crash = FindingRecord(kind=FindingKind.CRASHED, count=1, first_stamp_ns=None, text=text)
    save_stats(tmp_path / "s.csv", [record], {Task.LOCALISATION: method}, findings={Task.LOCALISATION: [crash]})
    read = load_call_stats(tmp_path / "s.csv")
    assert read.calls.states == ["lost"]
    assert [finding.kind for finding in read.findings] == [FindingKind.CRASHED, FindingKind.LATE]
    assert read.method is not None
    assert read.method.version == method.version
    assert printable(read.method.version) == read.method.version
    assert len((tmp_path / "s.csv").read_text().splitlines()) == 3


LOWER = np.eye(6)
LOWER[3, 0] = 0.5


@pytest.mark.parametrize(
    ("field", "values"),
    [("covariance", LOWER), ("covariance", -np.eye(6)), ("step", np.full(48, -1.0)), ("step", -np.eye(48)[27])],
)
def test_an_invalid_uncertainty_is_refused_in_a_message_and_in_a_file(
    tmp_path: Path, field: str, values: np.ndarray
) -> None:
    record = CallRecord(1, 0.1, "tracking", **{field: values})
    with pytest.raises(InputError, match=field):
        decode_call(encode_call(record), Task.LOCALISATION)
    with pytest.raises(InputError, match=field):
        save_stats(tmp_path / "s.csv", [record])
    assert not (tmp_path / "s.csv").exists()


def test_a_negative_variance_of_a_step_in_a_file_is_refused(tmp_path: Path) -> None:
    save_stats(tmp_path / "s.csv", [CallRecord(1, 0.1, "tracking", step=np.full(48, 0.25))])
    text = (tmp_path / "s.csv").read_text()
    (tmp_path / "s.csv").write_text(text.replace("0.25", "-0.25"))
    with pytest.raises(InputError, match="line 2: a variance of 'step'"):
        load_call_stats(tmp_path / "s.csv")


def test_the_warning_of_lost_poses_quotes_the_path() -> None:
    records = [CallRecord(1, 0.1, "lost")]
    assert (tracking_warning(records, "/a b", is_ours=False) or "").endswith("sfr info '/a b'")
    assert "sfr localise '/a b'" in (tracking_warning(records, "/a b") or "")


LARGEST = int(MAX_NUMBER)


@pytest.mark.parametrize(
    ("key", "accepted", "refused"),
    [
        ("stamp_ns", [0, STAMP_LIMIT - 1], [-1, STAMP_LIMIT, 1.5]),
        ("processing_time_s", [0.0, 1e6], [-1e-9, 1e7]),
        ("peak_rss_bytes", [0, LARGEST], [-1, LARGEST + 1]),
        ("above_idle_bytes", [0, LARGEST], [-1, LARGEST + 1]),
        ("statistics", [{"stage_x_s": 0.0}, {"threads": 1e18}, {"x": -1e18}, {"statistics.state": 1, "state": 2}], []),
        ("statistics", [], [{"stage_x_s": -1.0}, {"cpu_s": -1.0}, {"x": 1e19}, {"x": -1e19}, {"x\0": 1.0}]),
        ("statistics", [{f"x{k}": 1 for k in range(500)}], [{f"x{k}": 1 for k in range(501)}, {"x" * 101: 1.0}]),
        ("covariance", [(1e18 * np.eye(6)).tolist()], [(1e30 * np.eye(6)).tolist(), (-np.eye(6)).tolist()]),
        ("step", [[1e18] * 48], [[1e30] * 48, [-1e30] * 48, [-1.0] * 48]),
        ("reason", ["a\rb", "a\0b", "\x1b[31m", "x" * 2000], ["x" * 2001]),
        ("finding", ["crashed: a\rb"], ["x" * 2001]),
        ("pair_stamps_ns", [[0, 1]], [[-1], [STAMP_LIMIT], [1, 1]]),
    ],
)
def test_a_call_is_refused_exactly_if_its_file_could_not_be_read(
    tmp_path: Path, key: str, accepted: list[object], refused: list[object]
) -> None:
    for value in accepted:
        text = json.dumps({"stamp_ns": 5, "processing_time_s": 1.0, key: value})
        save_stats(tmp_path / "s.csv", [decode_call(text, Task.LOCALISATION)])
        assert len(load_call_stats(tmp_path / "s.csv").calls.stamps_ns) == 1
    for value in refused:
        with pytest.raises(InputError, match=r"^call of localisation: [^\n]*$"):
            decode_call(json.dumps({"stamp_ns": 5, "processing_time_s": 1.0, key: value}), Task.LOCALISATION)


@pytest.mark.parametrize("variance", [1e30, math.inf, -1.0, math.nan, 0.0])
def test_a_published_covariance_that_no_file_may_have_is_bounded_or_unknown(tmp_path: Path, variance: float) -> None:
    """A pose that is lost by its covariance remains lost; a negative variance is unknown."""
    drive = ReceivedDrive()
    drive.add_pose((1, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)), np.full((6, 6), variance))
    save_stats(tmp_path / "s.csv", drive.records)
    read = load_call_stats(tmp_path / "s.csv")
    published = drive.covariances[1][UPPER][None]
    for found in (estimates_of(drive.trajectory, read), estimates_of(drive.trajectory, None, published)):
        assert found.lost.tolist() == [variance >= 1e30]
        assert found.is_lost_known.tolist() == [variance >= 1e30]


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
    of_file = score_calls(stats_of(calls).calls, {}).figures
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
        '{"stamp_ns": 5, "processing_time_s": null}',
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
