"""What happened when: each state of localisation, silence, jumps of the stamps, limits; a run that is over ends all."""

from __future__ import annotations

from dataclasses import replace

from helpers.live_run import STEP_NS, call, health, pose_pair
from helpers.made_scores import LIMITS, whole_score
from sfr_loc_map.live.run_end import RunEnd
from sfr_loc_map.live.state import LiveState
from sfr_loc_map.live.timeline import MAX_EVENTS, EventKind, Timeline
from sfr_loc_map.live.updates import GraphNodes, PoseSample, PublishedScore
from sfr_loc_map.live.values import event_values, live_values
from sfr_loc_map.message_types import Level
from sfr_loc_map.metrics.judging.judge import judged_by
from sfr_loc_map.metrics.judging.limits_file import parse_limits
from sfr_loc_map.metrics.stored.score_json import to_json


def drive(
    state: LiveState,
    numbers: range,
    offset_s: float = 0.0,
    word: str = "tracking",
    jump_s: float = 0.0,
    reason: str = "",
) -> None:
    for number in numbers:
        for pose in pose_pair(number, 0.1 * number + offset_s, lost=word == "lost"):
            stamp_ns = pose.stamp_ns + round(jump_s * 1e9)
            state.put(PoseSample(pose.track, stamp_ns, pose.position, pose.quat_xyzw, pose.received_s, pose.covariance))
        state.put(call(number, 0.1 * number + offset_s, word, reason))


def test_what_happened_is_told_with_its_times() -> None:
    state = LiveState()
    drive(state, range(20))
    drive(state, range(20, 30), word="degraded", reason="few_landmarks")
    drive(state, range(30, 31))  # one frame between does not part them
    drive(state, range(31, 40), word="degraded", reason="few_landmarks")
    drive(state, range(40, 45), word="lost")
    drive(state, range(45, 50))
    assert live_values(state, 4.9)["stale_reasons"] == []
    state.tick(8.0)
    late = live_values(state, 8.0)
    assert late["stale_reasons"] == ["no pose for 3.1 s", "localisation_node silent for 3.1 s"]
    drive(state, range(50, 60), offset_s=4.0)
    drive(state, range(60, 70), offset_s=4.0, jump_s=3600.0)
    drive(state, range(70, 80), offset_s=4.0)
    state.put(health("mapping_node", 12.0, Level.ERROR, "out of memory"))
    limits = parse_limits(LIMITS | {"minimum_independent": 1}, "test")  # the drive is short
    state.put(PublishedScore(to_json(judged_by(whole_score(100, 48, 2), limits)), 12.0))
    state.end(RunEnd(aborted="monitor_node was killed by SIGKILL"), 13.0)
    told = [
        (event["kind"], round(event["from"], 1), event["to"])
        for event in event_values(state)["events"]
        if event["kind"] not in ("node", "silent")
    ]
    kinds = [kind for kind, *_ in told]
    assert kinds[:6] == ["tracking", "degraded", "lost", "tracking", "stale", "tracking"]
    assert [begin for _, begin, _ in told[:6]] == [0.0, 2.0, 4.0, 4.5, 4.9, 9.0]
    texts = " ".join(event["text"] for event in event_values(state)["events"])
    for expected in ("stamps jump forward by 3600.1 s", "stamps jump back by 3599.9 s", "mapping_node: out of memory"):
        assert expected in texts
    assert ": 27.52 mm, limit ≤ 0.001 mm, margin -27.52 mm" in texts
    assert all(end is not None for *_, end in told)
    ended = live_values(state, 20.0)
    assert (ended["ended"], ended["aborted"]) == (True, {"by": "monitor_node was killed by SIGKILL", "at": 13.0})
    assert ended["stale_reasons"] == []


def test_a_pose_is_lost_by_its_covariance_or_by_its_call_and_its_state_may_be_unknown() -> None:
    state = LiveState()

    def put(number: int, word: str | None, *, is_lost: bool = False) -> tuple[str, str]:
        state.put(pose_pair(number, 0.1 * number, lost=is_lost)[1])
        if word is not None:
            state.put(call(number, 0.1 * number, word, "diverged" if word == "lost" else ""))
        shown = live_values(state, 0.1 * number)["localisation"]
        return shown["state"], shown["reason"]

    assert put(0, None) == ("", "")
    assert event_values(state)["events"][-1]["text"] == "state unknown"
    assert put(1, None, is_lost=True) == ("lost", "")
    assert put(2, "tracking") == ("tracking", "")
    assert put(3, "tracking", is_lost=True) == ("lost", "")
    assert put(4, "lost", is_lost=True) == ("lost", "diverged")
    assert put(5, "tracking") == ("tracking", "")
    assert put(6, "lost") == ("lost", "diverged"), "an external localiser may publish a small covariance"
    told = [(event["kind"], event["text"]) for event in event_values(state)["events"]]
    assert told[-1] == ("lost", "lost: diverged")


def test_a_pose_is_stale_once_poses_or_its_node_stop() -> None:
    state = LiveState()
    state.put(GraphNodes(frozenset({"localisation_node"}), 0.0))
    state.put(pose_pair(0, 0.0)[1])
    assert not live_values(state, 0.1)["localisation"]["stale"], "the node has not reported yet"
    assert not live_values(state, 10.0)["localisation"]["stale"]
    assert live_values(state, 20.0)["localisation"]["stale"], "a single pose, and then none"
    drive(state, range(1, 20))
    assert not live_values(state, 2.0)["localisation"]["stale"]
    late = live_values(state, 5.9)["localisation"]
    assert (late["stale"], late["age_s"]) == (True, 4.0)
    for number in range(20, 60):
        state.put(pose_pair(number, 0.1 * number)[1])
    assert live_values(state, 5.9)["localisation"]["stale"], "the node is silent although poses arrive"


def test_a_node_is_silent_by_the_period_that_it_reports() -> None:
    for period_s, silent_s in ((1.0, 3.0), (10.0, 17.0)):
        state = LiveState()
        report = health("monitor_node", 1.0)
        state.put(replace(report, values=report.values | {"period_s": str(period_s)}))
        stale = [live_values(state, now_s)["nodes"][0]["stale"] for now_s in (1.0 + period_s, 1.0 + silent_s)]
        assert stale == [False, True]


def test_a_call_without_a_pose_leaves_the_poses_stale() -> None:
    state = LiveState()
    drive(state, range(20))
    state.tick(8.0)
    state.put(call(21, 8.1))
    assert [event["kind"] for event in event_values(state)["events"] if event["kind"] not in ("node", "silent")] == [
        "tracking",
        "stale",
    ]


def test_a_node_in_error_that_becomes_silent_has_two_events() -> None:
    state = LiveState()
    state.put(health("mapping_node", 1.0, Level.ERROR, "out of memory"))
    state.tick(9.0)
    events = [(event["kind"], event["from"], event["to"]) for event in event_values(state)["events"]]
    assert events == [("node", 1.0, 1.0), ("silent", 1.0, None)]
    state.put(health("mapping_node", 10.0))
    assert [event["to"] for event in event_values(state)["events"]] == [1.0, 10.0]


def test_a_run_that_ends_without_a_report_no_longer_waits_for_one() -> None:
    state = LiveState()
    assert live_values(state, 1.0)["headline"]["word"] == "waiting"
    state.end(RunEnd(aborted="the nodes did not start"), 2.0)
    ended = live_values(state, 3.0)["headline"]
    assert ended["word"] == "aborted"
    assert ended["text"].startswith("the nodes did not start at ")
    assert ended["text"].endswith(". The monitor reported no figures.")


def test_events_are_bounded() -> None:
    line = Timeline()
    for number in range(3 * MAX_EVENTS):
        line.note("node", float(number), EventKind.NODE if number % 2 else None, "silent")
        line.mark(float(number), EventKind.CLOCK, "jump")
    assert len(line.to_plain()) == MAX_EVENTS
    assert line.to_plain()[-1]["from"] == 3 * MAX_EVENTS - 1
    assert STEP_NS == 10**8


def test_two_limits_on_one_number_have_events_of_their_own() -> None:
    """With one lane for both, each report begins and ends the event of the missed limit."""
    state = LiveState()
    missed, met = (
        {"id": name, "condition": "distance=5", "position_mean_plus_3sigma_m": bound}
        for name, bound in (("A", 1e-6), ("B", 1e3))
    )
    limits = parse_limits({"trajectory": [missed, met], "minimum_independent": 1}, "test")
    for at_s in (1.0, 2.0, 3.0):
        state.put(PublishedScore(to_json(judged_by(whole_score(100, 48, 2), limits)), at_s))
    events = [
        (event["from"], event["to"]) for event in event_values(state)["events"] if event["kind"] == EventKind.LIMIT
    ]
    assert events == [(1.0, None)]
