"""The path of a live run: each estimate is shown with the ground truth of its stamp."""

from __future__ import annotations

import json
import math
import shutil
import subprocess
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest

from sfr_loc_map import live
from sfr_loc_map.geometry.plausibility import LOST_VARIANCE
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.live.path import LivePath
from sfr_loc_map.live.state import LiveState
from sfr_loc_map.live.updates import PoseSample, PublishedScore, Track
from sfr_loc_map.live.values import event_values, live_values
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.metrics.figures.records import Association, Provenance
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.stored.score_json import to_json

MAX_ROWS = 400
DRAWN_PATH = """
const box = new Proxy({ style: {}, dataset: {}, append() {}, replaceChildren() {} }, { get: (o, k) => o[k] ?? 300 });
globalThis.document = { getElementById: () => box, createElement: () => ({ append() {} }) };
globalThis.getComputedStyle = () => ({ getPropertyValue: () => "" });
globalThis.matchMedia = () => ({ matches: false });
globalThis.Plotly = { react: (_, traces) => console.log(JSON.stringify(traces.map((trace) => trace.name))) };
const { Run } = await import("./run.js");
const { showPath } = await import("./path.js");
const run = new Run();
run.take(JSON.parse(process.argv[2]));
showPath(run);
"""
"""Script that draws a path with a stub of the page and prints the names of the traces."""


@pytest.fixture
def short_path(monkeypatch: pytest.MonkeyPatch) -> None:
    """A path of at most `MAX_ROWS` rows, a tenth of the usual number."""
    monkeypatch.setattr("sfr_loc_map.live.path.MAX_ROWS", MAX_ROWS)


def pose(track: Track, number: float, transform: Transform, variance: float = 1e-4) -> PoseSample:
    (x, y, z), (a, b, c, d) = transform.translation.tolist(), transform.quat_xyzw.tolist()
    covariance = np.eye(6) * variance if track is Track.ESTIMATE else None
    return PoseSample(track, round((number + 1) * NS_PER_S / 10), (x, y, z), (a, b, c, d), number, covariance)


def turned(x: float, y: float, yaw: float) -> Transform:
    return Transform.from_quat((x, y, 0.0), (0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)))


def drive(number: float) -> Transform:
    return turned(0.1 * number, 0.02 * number, 0.01 * number)


def test_estimate_is_shown_in_the_frame_of_the_truth() -> None:
    path, other_frame = LivePath(), turned(5.0, -3.0, 1.0)
    for number in range(20):
        path.add(pose(Track.TRUTH, number, drive(number)))
        path.add(pose(Track.ESTIMATE, number, other_frame @ drive(number)))
    assert len(path.rows) == 20
    for row in path.rows:
        assert row.error_m == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
        assert row.position_m == pytest.approx(drive(row.n).translation.tolist(), abs=1e-9)
    assert path.rows[-1].distance_m == pytest.approx(19 * math.hypot(0.1, 0.02))


@pytest.mark.parametrize("known", [range(5, 20), range(12), [*range(6), *range(12, 20)]])
def test_the_distance_travelled_has_no_step_from_one_frame_to_the_other(known: Iterable[int]) -> None:
    """The truth begins late, ends early or has a gap; the start pose is far from the identity."""
    path, other_frame, with_truth = LivePath(), turned(5.0, -30.0, 1.0), set(known)
    for number in range(20):
        if number in with_truth:
            path.add(pose(Track.TRUTH, number, drive(number)))
        path.add(pose(Track.ESTIMATE, number, other_frame @ drive(number)))
    assert path.rows[-1].distance_m == pytest.approx(path.rows[-1].n * math.hypot(0.1, 0.02))


@pytest.mark.parametrize("joined", [0, 12])
def test_a_viewer_that_joins_late_shows_the_distance_of_the_run(joined: int) -> None:
    """The length before comes with the score; a run that begins while the viewer is there has nothing before it."""
    state, step_m = LiveState(), math.hypot(0.1, 0.02)
    for number in range(joined, 20):
        for track in Track:
            state.put(pose(track, number, drive(number)))
    score = Score(association=Association(matched=20, estimate_poses=20, truth_poses=20, path_length_m=19 * step_m))
    state.put(PublishedScore(to_json(score), 1.0))
    assert live_values(state, 1.0)["localisation"]["distance_m"] == pytest.approx(19 * step_m)
    state.put(pose(Track.TRUTH, 20, drive(20)))
    state.put(pose(Track.ESTIMATE, 20, drive(20)))
    state.put(PublishedScore(to_json(score), 1.0))  # without the newest pose
    assert live_values(state, 1.0)["localisation"]["distance_m"] == pytest.approx(20 * step_m)
    for number in range(10):  # as many as begin a run if their stamps are unknown
        for track in Track:
            state.put(pose(track, number, drive(number)))
    state.put(PublishedScore(to_json(score), 2.0))  # of the run before
    assert live_values(state, 2.0)["localisation"]["distance_m"] == pytest.approx(9 * step_m)


@pytest.mark.parametrize(
    ("parameter", "value", "has_error"),
    [("lever_arm_m", [1.0, 0.0, 0.0], False), ("frame", "map:base", False), ("lever_arm_m", [0.0, 0.0, 0.0], True)],
)
def test_no_error_is_shown_against_a_truth_that_the_monitor_converts(
    parameter: str, value: object, has_error: bool
) -> None:
    """The monitor does not score the error between RB and, for example, an antenna 1 m ahead of RB."""
    state = LiveState()
    made = Provenance(version="0", configuration={"monitor": {f"truth.{parameter}": value}})

    def add(number: int) -> None:
        for track in (Track.TRUTH, Track.ESTIMATE):
            state.put(pose(track, number, drive(number)))

    for number in range(5):
        add(number)
    assert all(row.error_m is not None for row in state.path.rows)
    state.put(PublishedScore(to_json(Score(provenance=made)), 1.0))
    add(5)
    assert {row.error_m is not None for row in state.path.rows} == {has_error}
    assert all(row.truth_m is not None for row in state.path.rows)


@pytest.mark.skipif(shutil.which("node") is None, reason="node is not installed")
@pytest.mark.parametrize("is_converted", [False, True])
def test_the_page_draws_a_path_whose_truth_has_no_errors(tmp_path: Path, is_converted: bool) -> None:
    path = LivePath()
    path.note_conversion(is_converted=is_converted)
    for number in range(5):
        for track in (Track.TRUTH, Track.ESTIMATE):
            path.add(pose(track, number, drive(number)))
    assert path.newest is not None
    rows = [row.to_plain() for row in path.rows]
    message = {"type": "path", "whole": True, "rows": rows, "last": path.newest.to_plain(), "before_m": 0.0}
    for script in Path(live.__file__).parent.glob("web/*.js"):
        shutil.copy(script, tmp_path)
    (tmp_path / "package.json").write_text('{"type": "module"}')
    (tmp_path / "test.js").write_text(DRAWN_PATH)
    command = ["node", str(tmp_path / "test.js"), json.dumps(message)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert not done.returncode, done.stderr
    names = json.loads(done.stdout)
    assert "truth" in names
    assert any(name.startswith("error") for name in names) == (not is_converted)


@pytest.mark.parametrize("stray", [-19.5, 4 * 36000.0])
def test_a_stray_pose_leaves_the_path_as_it_is_and_three_in_a_row_begin_another_one(stray: float) -> None:
    state = LiveState()
    for number in range(20, 40):
        for track in Track:
            state.put(pose(track, number, drive(number)))
    for track in Track:
        state.put(pose(track, 40 + stray, drive(0)))
    for track in Track:
        state.put(pose(track, 40, drive(40)))
    assert [row.stamp_ns for row in state.path.rows] == [(number + 1) * NS_PER_S // 10 for number in range(20, 41)]
    assert not [event for event in event_values(state)["events"] if event["kind"] == "clock"]
    for number in range(20, 23):
        for track in Track:
            state.put(pose(track, number, drive(number)))
    assert [row.stamp_ns for row in state.path.rows] == [(number + 1) * NS_PER_S // 10 for number in range(20, 23)]
    texts = [event["text"] for event in event_values(state)["events"] if event["kind"] == "clock"]
    assert texts == ["stamps jump back by 2.0 s"]


def test_late_poses_begin_no_run_on_the_page_because_they_begin_none_in_the_monitor() -> None:
    """Poses that were not received before and arrive 2 s late are of the run, although the path cannot show them."""
    state = LiveState()
    late = (20, 21, 22)
    for number in range(43):
        if number not in late:
            state.put(pose(Track.ESTIMATE, number, drive(number)))
    for number in late:
        state.put(pose(Track.ESTIMATE, number, drive(number)))
    state.put(pose(Track.ESTIMATE, 43, drive(43)))
    shown = [row.stamp_ns for row in state.path.rows]
    assert shown == [(number + 1) * NS_PER_S // 10 for number in range(44) if number not in late]
    assert not [event for event in event_values(state)["events"] if event["kind"] == "clock"]


@pytest.mark.usefixtures("short_path")
def test_the_last_pose_is_shown_also_if_the_path_is_thinned() -> None:
    """A long path keeps every second pose and a short loss; the pose that is displayed is the last received one."""
    state = LiveState()
    for number in range(MAX_ROWS + 2):
        state.put(pose(Track.ESTIMATE, number, drive(number)))
    lost, last = MAX_ROWS + 2, MAX_ROWS + 5
    state.put(pose(Track.ESTIMATE, lost, drive(lost), LOST_VARIANCE))
    for number in range(lost + 1, last + 1):
        state.put(pose(Track.ESTIMATE, number, drive(number)))
    live = live_values(state, last)
    assert live["localisation"]["position_m"] == pytest.approx(drive(last).translation.tolist())
    assert not live["localisation"]["lost"]
    assert live["poses"] == last + 1
    assert [row.n for row in state.path.rows[-3:]] == [lost, lost + 1, last - 1]
    assert state.path.newest is not None
    assert state.path.newest.n == last


@pytest.mark.usefixtures("short_path")
@pytest.mark.parametrize("lost_count", [MAX_ROWS, 5 * MAX_ROWS])
def test_a_long_loss_leaves_room_for_later_poses(lost_count: int) -> None:
    """The path shows the poses after a loss of an hour as densely as the poses before the loss."""
    path = LivePath()
    found_count = MAX_ROWS // 4
    for number in range(2 * found_count + lost_count):
        is_lost = found_count <= number < found_count + lost_count
        path.add(pose(Track.ESTIMATE, number, drive(number), LOST_VARIANCE if is_lost else 1e-4))
    before, after = ([row for row in path.rows if (row.n < found_count) is is_before] for is_before in (True, False))
    shown = len([row for row in after if not row.lost])
    assert len(before) > 5
    assert shown == pytest.approx(len(before), abs=2)


@pytest.mark.usefixtures("short_path")
def test_a_thinned_path_is_bounded_and_shows_each_short_loss() -> None:
    path, lost = LivePath(), {MAX_ROWS // 2, 3 * MAX_ROWS}
    for number in range(4 * MAX_ROWS):
        path.add(pose(Track.ESTIMATE, number, drive(number), LOST_VARIANCE if number in lost else 1e-4))
        assert len(path.rows) <= MAX_ROWS
    assert {row.n for row in path.rows if row.lost} == lost
    for number in range(4 * MAX_ROWS, 6 * MAX_ROWS):  # tracking that is lost at every second pose
        path.add(pose(Track.ESTIMATE, number, drive(number), LOST_VARIANCE if number % 2 else 1e-4))
        assert len(path.rows) <= MAX_ROWS
