"""The state of a live run: its JSON is the monitor's report with additions, its memory is bounded."""

from __future__ import annotations

import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from helpers.live_run import NODES, call, fill, frame, health, scored
from helpers.made_scores import HOSTILE, dig, half, json_of, whole_score
from sfr_loc_map.calls.call_record import STATES_OF, CallRecord
from sfr_loc_map.live.call_log import MAX_CALLS
from sfr_loc_map.live.run_end import RunEnd
from sfr_loc_map.live.state import MAX_NODES, LiveState
from sfr_loc_map.live.updates import GraphNodes, ImageStamp, NodeCall, PoseSample, PublishedScore, Status, Track, Update
from sfr_loc_map.live.values import event_values, live_values, state_json
from sfr_loc_map.message_types import StatusKind
from sfr_loc_map.metrics.conditions import Condition, ConditionKind
from sfr_loc_map.metrics.config import ScoreConfig, TrajectoryScoreConfig
from sfr_loc_map.metrics.judging.judge import judged_by
from sfr_loc_map.metrics.stored.score_json import to_json
from sfr_loc_map.report.score_tables import score_tables
from sfr_loc_map.suite_names import Task


def test_state_is_the_report_with_additions_and_the_strings_of_its_tables() -> None:
    state = LiveState()
    fill(state, 30)
    score, content = whole_score(100, 48, 2), state_json(state, state.path.rows[-1].received_s)
    live = content.pop("live")
    assert content == json_of(score)
    assert live["poses"] == 30
    assert [node["name"] for node in live["nodes"]] == sorted(NODES)
    json.dumps(live, allow_nan=False)
    shown = {table["name"]: table for table in live["tables"]}
    for table in score_tables(score):
        texts = [[cell.get("text", "") for cell in row] for row in shown[table.name]["rows"]]
        assert texts == [[cell.text for cell in row] for row in table.rows]
    headline = next(table for table in score_tables(score) if table.name == "headline")
    keys = [cell.key for row in headline.rows for cell in row if cell.value is not None]  # known numbers
    assert len(keys) > 10
    for key in keys:
        dig(content, key)
    before = state.score
    state.put(PublishedScore("{", 1.0))
    assert state.score is before is not None
    assert "metrics/report is not JSON" in state.problems[-1]


def test_a_run_is_incomplete_by_its_report_or_by_the_images_of_its_source() -> None:
    """The page shows the verdict of the report as it is; the end of a run can only add what has no pose."""
    whole = judged_by(whole_score(100, 48, 2), None)
    part = half(whole)
    for partial, verdict in ((False, "incomplete"), (True, "no verdict")):
        report, state = PublishedScore(to_json(judged_by(part, None, partial=partial)), 1.0), LiveState()
        state.put(report)
        under_way = state_json(state, 1.0)
        assert under_way["live"]["overall"]["state"] == verdict
        state.end(RunEnd(), 1.0)
        for _ in range(2):
            ended = state_json(state, 1.0)
            assert ended["live"]["overall"]["state"] == verdict
            assert ("covers 50 %" in (ended.get("incomplete") or "")) == (not partial)
            assert ended["figures"] == under_way["figures"]
            state.put(report)  # a last one that comes late


def test_the_score_of_the_complete_run_replaces_that_of_the_monitor() -> None:
    """The monitor does not know the images of the source, and the end of a run is reported several times."""
    of_monitor = PublishedScore(to_json(whole_score(100, 48, 2)), 1.0)
    final = judged_by(half(judged_by(whole_score(100, 48, 2), None)), None)
    state = LiveState()
    state.put(of_monitor)
    state.end(RunEnd(), 1.0)
    state.end(RunEnd(score=to_json(final)), 2.0)
    state.end(RunEnd(score=to_json(final), report="report.html"), 3.0)
    state.put(of_monitor)  # a last one that comes late
    shown = state_json(state, 4.0)
    assert shown.pop("live")["overall"]["state"] == "incomplete"
    assert shown == json_of(final)


def test_a_report_without_poses_has_the_age_of_its_reception() -> None:
    """A report is latched, so that it is the only message of nodes that are paused or have finished."""
    state = LiveState()
    state.put(PublishedScore(to_json(whole_score(100, 48, 2)), 1000.0))
    assert live_values(state, 1003.0)["age_s"] == 3.0
    state.put(frame(0, 1001.0)[-1])
    assert live_values(state, 1003.0)["age_s"] == 3.0
    state.put(PublishedScore(to_json(whole_score(100, 48, 2)), 1002.0))
    assert live_values(state, 1003.0)["age_s"] == 2.0


@pytest.mark.parametrize("kind", [*ConditionKind, "distance=1,time=1"])
def test_errors_are_those_that_the_monitor_has_scored(kind: str) -> None:
    condition = kind if "=" in kind else f"{kind}=3"
    state, score = LiveState(), scored(100, ScoreConfig(TrajectoryScoreConfig(conditions=(condition,), spacing=5)))
    for number in range(100):
        for update in frame(number, 0.1 * number):
            state.put(update)
        if number == 50:
            state.put(PublishedScore(to_json(score), 5.0))
    assert not state.problems
    assert score.details is not None
    assert score.details.trajectory is not None
    rows = score.details.trajectory.sub_trajectories[0]
    found = state_json(state, 10.0)["live"]["errors"]
    assert found["over"] == Condition.parse(condition).label
    assert found["end_frame"] == rows.end_frame
    assert len(rows.end_frame) > 10
    assert found["position_m"] == [math.hypot(*row) for row in zip(rows.x_m, rows.y_m, rows.z_m, strict=True)]
    assert state.path.rows[-1].truth_m is not None


def test_a_new_run_shows_no_call_of_the_previous_one() -> None:
    state = LiveState()
    for number in range(20):
        for update in frame(number, float(number)):
            state.put(update)
        state.put(call(number, float(number)))
    for number in range(5):  # three poses begin a run
        for update in frame(number, 100.0 + number):
            state.put(update)
        state.put(call(number, 100.0 + number))
    assert [item.call.received_s for item in state.calls] == [100.0 + number for number in range(5)]
    assert (state.calls.first, state.calls.end) == (20, 25)


def test_memory_is_bounded() -> None:
    state = LiveState()
    for number in range(MAX_CALLS + 50):
        state.put(call(number, float(number)))
        state.put(health(f"node_{number}", float(number)))
        state.put(ImageStamp(f"topic_{number}", number, float(number)))
    assert (len(state.calls), len(state.nodes), len(state.topics.by_name)) == (MAX_CALLS, MAX_NODES, MAX_NODES)
    for number in range(4000):  # all of one moment: a smoothed period of 1e-320 s has no reciprocal
        state.put(ImageStamp("topic_0", number, 1e4))
    assert state_json(state, 1e4)["live"]["topics"]["topic_0"]["rate_hz"] is None


words = st.text(max_size=20) | st.sampled_from([HOSTILE, "nan", "1e999", "-1", "\x00", "9" * 400])
numbers = st.floats() | st.integers(-(2**70), 2**70)
figures = ["stamp_ns", "processing_time_s", "peak_rss_bytes", "lifecycle", "latency_transport_s"]
values = st.dictionaries(st.sampled_from(figures) | words, words | numbers.map(str), max_size=6)
reports = words | st.sampled_from(["{}", '{"schema": "sfr-score/2", "verdicts": [], "x": 1e999}'])
quats = st.tuples(numbers, numbers, numbers, numbers) | st.just((0.0, 0.0, 0.0, 1.0))
places, times = st.tuples(numbers, numbers, numbers), st.floats(0, 1e10)
updates = st.one_of(
    st.builds(PublishedScore, reports, times),
    st.builds(
        NodeCall,
        words,
        st.builds(
            CallRecord,
            st.integers(0, 2**63),
            times | st.just(math.nan),
            st.sampled_from(["", *STATES_OF[Task.LOCALISATION]]),
            reason=words,
        ),
        times,
    ),
    st.builds(Status, words, st.sampled_from(StatusKind), st.integers(-300, 300), words, values, times),
    st.builds(PoseSample, st.sampled_from(Track), st.integers(0, 2**63), places, quats, times),
    st.builds(GraphNodes, st.frozensets(words, max_size=3), times),
)


@given(st.lists(updates, max_size=6))
def test_whatever_comes_the_state_can_be_told(found: list[Update]) -> None:
    state = LiveState()
    for update in found:
        state.put(update)
    records = [item.to_plain() for item in (*state.calls, *state.path.rows)]
    json.dumps([state_json(state, 1e9), *records], allow_nan=False)


def test_reading_the_state_changes_no_event() -> None:
    state = LiveState()
    fill(state, 30)
    last_s = state.path.rows[-1].received_s
    before = event_values(state)["events"]
    state_json(state, last_s + 60.0)
    assert event_values(state)["events"] == before
    state.tick(last_s + 60.0)
    assert {event["kind"] for event in event_values(state)["events"]} > {event["kind"] for event in before}
