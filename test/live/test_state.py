"""The state of a live run: its JSON is the monitor's report with additions, its memory is bounded."""

from __future__ import annotations

import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from live_run import NODES, call, fill, health
from made_scores import HOSTILE, dig, json_of, whole_score

from sfr_loc_map.live.hub import MAX_WAITING, Hub
from sfr_loc_map.live.state import MAX_CALLS, MAX_NODES, STALE_AFTER_S, LiveState, TopicView
from sfr_loc_map.live.updates import GraphView, PoseSample, Report, Sampled, Status, StatusKind, Track, Update
from sfr_loc_map.metrics.score_json import from_dict, to_json
from sfr_loc_map.report.score_tables import score_tables


def filled(frames: int = 30) -> LiveState:
    hub, state = Hub(), LiveState()
    fill(hub, frames)
    for update in hub.take():
        state.apply(update)
    return state


@pytest.fixture(scope="module")
def run() -> LiveState:
    return filled()


def test_state_is_the_report_with_additions(run: LiveState) -> None:
    content = run.to_plain(run.path.rows[-1].received_s)
    live = content.pop("live")
    assert content == json_of(whole_score(100, 48, 2, 2))
    assert from_dict(content).verdicts
    assert live["poses"] == 30
    assert [node["name"] for node in live["nodes"]] == sorted(NODES)
    json.dumps(live, allow_nan=False)


def test_strings_are_those_of_the_table_model(run: LiveState) -> None:
    shown = {table["name"]: table for table in run.live_to_plain(0.0)["tables"]}
    for table in score_tables(whole_score(100, 48, 2, 2)):
        texts = [[cell.get("text", "") for cell in row] for row in shown[table.name]["rows"]]
        assert texts == [[cell.text for cell in row] for row in table.rows]
    content = json_of(whole_score(100, 48, 2, 2))
    keyed = [cell for row in shown["live"]["rows"] for cell in row if "key" in cell]
    assert len(keyed) > 10
    for cell in keyed:
        dig(content, cell["key"])


def test_limits_stand_beside_their_figures(run: LiveState) -> None:
    (table,) = (table for table in run.live_to_plain(0.0)["tables"] if table["name"] == "live")
    rows = {row[0]["text"]: [cell.get("text") for cell in row] for row in table["rows"]}
    assert rows["position error over 5 m"][6:8] == ["mean + 3 sigma ≤ 0.001 mm", "fail"]
    assert rows["heading error over 5 m"][6:8] == ["mean + 3 sigma ≤ 90 deg", "pass"]
    assert rows["position error over 500 m"][6:8] == ["mean + 3 sigma ≤ 100 mm", "not enough data"]
    assert rows["attitude error over 5 m"][6:8] == ["-", "-"]


def test_silent_nodes_are_stale_and_recover() -> None:
    state = LiveState()
    for number in range(4):
        state.apply(health("localisation_node", float(number)))
    node = state.nodes["localisation_node"]
    assert not node.is_stale(3.0 + STALE_AFTER_S - 0.1)
    assert node.is_stale(3.0 + STALE_AFTER_S + 0.1)
    assert node.to_plain(6.0)["level"] == "stale"
    state.apply(health("localisation_node", 6.0, 2, "lost: few_landmarks"))
    assert node.to_plain(6.1)["level"] == "error"


def test_a_node_with_a_longer_period_is_given_it() -> None:
    state = LiveState()
    for number in range(5):
        state.apply(health("monitor_node", 5.0 * number))
    assert not state.nodes["monitor_node"].is_stale(20.0 + 7.0)
    assert state.nodes["monitor_node"].is_stale(20.0 + 9.0)


def test_messages_that_are_all_of_one_moment_have_no_rate() -> None:
    topic = TopicView(None, 0.0)
    topic.add(1, 1.0)
    for number in range(4000):  # a smoothed period of 1e-320 s has no reciprocal
        topic.add(number, 1.0)
    state = LiveState()
    state.topics["nav/pose"] = topic
    assert state.to_plain(2.0)["live"]["topics"]["nav/pose"]["rate_hz"] is None


def test_memory_is_bounded() -> None:
    state = LiveState()
    for number in range(MAX_CALLS + 50):
        state.apply(call(number, float(number)))
        state.apply(health(f"node_{number}", float(number)))
        state.apply(Sampled(f"topic_{number}", number, float(number)))
    assert len(state.calls) == MAX_CALLS
    assert len(state.nodes) <= MAX_NODES
    assert len(state.topics) <= MAX_NODES
    hub = Hub()
    for number in range(MAX_WAITING + 7):
        hub.put(Sampled("loc/left", number, 0.0))
    assert hub.dropped == 7
    assert len(hub.take()) == MAX_WAITING


def test_newest_image_replaces_one_that_waits() -> None:
    hub = Hub()
    woken: list[int] = []
    hub.on_arrival(lambda: woken.append(1))
    fill(hub, 2)
    fill(hub, 2)
    assert len(woken) == 1
    assert hub.replaced == 5
    assert hub.take()
    assert hub.take() == []


words = st.text(max_size=20) | st.sampled_from([HOSTILE, "nan", "1e999", "-1", "\x00", "9" * 400])
numbers = st.floats() | st.integers(-(2**70), 2**70)
updates = st.one_of(
    st.builds(
        Report, words | st.sampled_from(["{}", '{"schema": "sfr-score/1", "verdicts": [], "x": 1e999}']), numbers
    ),
    st.builds(
        Status,
        words,
        st.sampled_from(StatusKind),
        st.integers(-300, 300),
        words,
        st.dictionaries(
            st.sampled_from(["stamp_ns", "processing_time_s", "peak_rss_bytes", "lifecycle", "latency_transport_s"])
            | words,
            words | numbers.map(str),
            max_size=6,
        ),
        st.floats(0, 1e10),
    ),
    st.builds(
        PoseSample,
        st.sampled_from(Track),
        st.integers(0, 2**63),
        st.tuples(numbers, numbers, numbers),
        st.tuples(numbers, numbers, numbers, numbers) | st.just((0.0, 0.0, 0.0, 1.0)),
        st.floats(0, 1e10),
    ),
    st.builds(GraphView, st.frozensets(words, max_size=3), st.floats(0, 1e10)),
)


@settings(max_examples=30)
@given(st.lists(updates, max_size=6))
def test_whatever_comes_the_state_can_be_told(found: list[Update]) -> None:
    state = LiveState()
    for update in found:
        state.apply(update)
    json.dumps(state.to_plain(1e9), allow_nan=False)
    json.dumps(list(state.calls), allow_nan=False)
    json.dumps([row.to_plain() for row in state.path.rows], allow_nan=False)


def test_a_report_that_is_none_leaves_the_last_one() -> None:
    state = filled(2)
    state.apply(Report("{", 1.0))
    assert state.report is not None
    assert "metrics/report is no JSON" in state.problems[-1]
    assert to_json(whole_score(100, 48, 2, 2))
