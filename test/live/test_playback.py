"""What is played has the figures of `sfr score` at its end, and at each place those of that place."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer

from helpers.made_scene import PERIOD_NS, START_NS, nav_pair, true_pose, write_folder
from helpers.score_rows import row, rows_about
from sfr_loc_map.config import build
from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.bag import ODOMETRY, TYPESTORE
from sfr_loc_map.io.bag_messages import odometry
from sfr_loc_map.io.cloud_file import save_cloud
from sfr_loc_map.io.trajectory_file import save_trajectory
from sfr_loc_map.live.playback import Player, open_recording
from sfr_loc_map.live.state import LiveState
from sfr_loc_map.live.updates import Action, CloudSample, Command, ElevationSample, TimeLine, View
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.metrics.limits import parse_limits
from sfr_loc_map.metrics.score_json import to_dict, to_json
from sfr_loc_map.runs.calls import CallRecord, save_stats
from sfr_loc_map.scoring.score_run import ScoreInputs, score_files

COUNT, NAV_COUNT, LOST_AT = 40, 2, 25
NAV_STAMPS = tuple(START_NS + n * PERIOD_NS for n in range(NAV_COUNT))
CONFIG = build(ScoreConfig, {"trajectory.conditions": ("frames=5", "time=1"), "trajectory.spacing": 3})
STATISTICS = {"stage_tracking_s": 0.01, "latency_transport_s": 0.002}
STEP = np.concatenate([np.eye(6)[np.triu_indices(6)] * 1e-5, np.full(6, 1e-4)])


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_folder(tmp_path_factory.mktemp("playback") / "source", COUNT, NAV_COUNT)


def estimate() -> Trajectory:
    rng = np.random.default_rng(3)
    poses = [true_pose(index) for index in range(COUNT)]
    positions = np.array([pose.translation for pose in poses]) + rng.normal(0, 0.002, (COUNT, 3)).cumsum(axis=0)
    stamps = START_NS + PERIOD_NS * np.arange(COUNT)
    return Trajectory(stamps, positions, np.array([pose.quat_xyzw for pose in poses]))


def calls() -> list[CallRecord]:
    made = []
    for index, stamp_ns in enumerate(estimate().stamps_ns.tolist()):
        lost, took = index == LOST_AT, 0.02 + 1e-4 * index
        state = "lost" if lost else "degraded" if index == 7 else "tracking"
        covariance = np.eye(6) * (9999.0 if lost else 1e-4 * (index + 1))
        costs = (stamp_ns, took, state, 300_000_000 + index, 1000, STATISTICS)
        made.append(CallRecord(*costs, covariance, "x" if lost else "", None if lost else STEP))
    made += [CallRecord(stamp_ns, 0.5, "mapped", 200_000_000, 2000) for stamp_ns in NAV_STAMPS]
    return [*made, CallRecord(NAV_STAMPS[-1], 0.1, "fused", 200_000_000, 2000, {"pairs": NAV_COUNT, "fused": 1.0})]


def cloud() -> PointCloud:
    v, u = np.mgrid[0:120:4, 0:160:4].astype(np.uint16)
    xyz = np.concatenate([(nav_pair(n).truth[v, u] + 0.01 * (n + 1)).reshape(-1, 3) for n in range(NAV_COUNT)])
    pixels = np.tile(u.ravel(), NAV_COUNT), np.tile(v.ravel(), NAV_COUNT)
    pair, ones = np.repeat(np.arange(NAV_COUNT, dtype=np.uint8), u.size), np.ones(len(xyz), np.float32)
    known = {"fused": True, "pair_stamps_ns": NAV_STAMPS}
    return PointCloud(xyz.astype(np.float32), 0.01 * ones, 100 * ones, *pixels, pair, **known)


@pytest.fixture(scope="module")
def out(source: Path) -> Path:
    """A finished replay, without the report."""
    folder = source.parent / "out"
    folder.mkdir()
    save_trajectory(folder / "estimate.csv", estimate())
    save_stats(folder / "stats.csv", calls())
    save_cloud(folder / "cloud.ply", cloud())
    return folder


def played(path: Path) -> LiveState:
    state = LiveState()
    player = Player(state, open_recording(path), CONFIG, None)
    player.advance(1e9)
    player.report()
    assert not state.problems
    return state


def write_run(path: Path) -> Path:
    """A recording of a live run, without images: poses, truth, calls and health."""
    said = "diagnostic_msgs/msg/DiagnosticArray"
    names = ("KeyValue", "DiagnosticStatus", "DiagnosticArray")
    pair, status, array = (TYPESTORE.types[f"diagnostic_msgs/msg/{name}"] for name in names)
    track = estimate()
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topics = {"/localisation/odometry": ODOMETRY, "/ground_truth/odometry": ODOMETRY, "/diagnostics": said}
        put = {name: writer.add_connection(name, kind, typestore=TYPESTORE) for name, kind in topics.items()}
        for row, record in enumerate(calls()[:COUNT]):
            message = odometry(record.stamp_ns, track.positions[row], track.quats_xyzw[row])
            message.pose.covariance[:] = np.asarray(record.covariance).ravel()
            truth = odometry(record.stamp_ns, true_pose(row).translation, true_pose(row).quat_xyzw)
            values = {"task": "localisation", "stamp_ns": str(record.stamp_ns), "state": record.state}
            values["processing_time_s"] = repr(record.processing_time_s)
            call = status(0, "localisation_node: call", record.state, "host", [pair(*item) for item in values.items()])
            health = status(1, "localisation_node: health", "warm", "host", [pair("lifecycle", "active")])
            messages = truth, message, array(message.header, [call, health])
            names = "/ground_truth/odometry", "/localisation/odometry", "/diagnostics"
            for later, (name, item) in enumerate(zip(names, messages, strict=True)):
                data = TYPESTORE.serialize_cdr(item, topics[name])
                writer.write(put[name], record.stamp_ns + 10**9 + later, data)
    return path


def test_a_recording_of_a_run_is_played_with_what_its_nodes_said(tmp_path: Path) -> None:
    bag = write_run(tmp_path / "run")
    state = played(bag)
    assert state.report is not None
    wanted = to_dict(score_files(ScoreInputs.of(bag, bag), CONFIG))
    for name in ("position", "attitude", "heading"):
        assert row(state.report.content, name) == row(wanted, name)
    for name in ("matched", "lost"):
        assert state.report.content["association"][name] == wanted["association"][name]
    node = state.nodes["localisation_node"]
    assert (node.message, node.level, node.state) == ("warm", 1, "tracking")


def check_final(state: LiveState, source: Path, out: Path) -> None:
    """The figures are those of `sfr score`; what is lost is lost, and the map has its distances to the truth."""
    assert state.report is not None
    stats, content = (out / "stats.csv",), state.report.content
    drive, cloud = (
        to_dict(score_files(ScoreInputs.of(out / name, source, stats), CONFIG))
        for name in ("estimate.csv", "cloud.ply")
    )
    for subject in ("trajectory", "timing", "memory"):
        assert rows_about(content, subject) == rows_about(drive, subject)
    assert content["association"] == drive["association"]
    assert rows_about(content, "map") == rows_about(cloud, "map")
    assert content["association"]["lost"] == content["association"]["degraded"] == 1
    assert [row.lost for row in state.path.rows].index(True) == LOST_AT
    assert state.path.rows[-1].truth_m is not None
    shown = state.media["mapping/points"]
    assert isinstance(shown, CloudSample)
    assert isinstance(state.media["mapping/elevation"], ElevationSample)
    assert shown.error is not None
    assert np.median(shown.error) == pytest.approx(0.0173, abs=0.02)
    assert state.nodes["localisation_node"].state == "tracking"
    assert state.calls[-1]["memory_bytes"] == 300_000_000 + COUNT - 1


def test_player_has_the_figures_of_its_place_pauses_jumps_back_and_ends(source: Path, out: Path) -> None:
    state = LiveState()
    recording = open_recording(out, source)
    assert recording.end_s == pytest.approx((COUNT - 1) * 0.1)
    state.looks["test"] = frozenset(View)

    def until(condition: Callable[[], bool]) -> None:
        end = time.monotonic() + 60.0
        while state.time_line is None or not condition():
            assert time.monotonic() < end
            time.sleep(0.02)

    def at_s() -> float:
        return -1.0 if state.time_line is None else state.time_line.at_s

    with Player(state, recording, CONFIG, None, rate=50.0) as player:
        until(lambda: at_s() >= recording.end_s)
        check_final(state, source, out)
        final = state.report.content if state.report is not None else {}
        last = dict.fromkeys(("loc/left", "loc/right"), START_NS + (COUNT - 1) * PERIOD_NS)
        last |= dict.fromkeys(("nav/left", "nav/right"), NAV_STAMPS[-1])
        until(lambda: last.items() <= {name: each.stamp_ns for name, each in state.media.items()}.items())
        assert player.run(Command(Action.SEEK, at_s=1.05)).startswith("goes to 1.")
        until(lambda: state.time_line == TimeLine(1.05, recording.end_s, False))
        assert state.path.rows[-1].n == 10
        assert state.report is not None
        assert state.report.content["association"]["estimate_poses"] == 11
        assert not state.live_to_plain(time.time() + 100.0)["stale"], "a player that stands still makes nothing stale"
        player.run(Command(Action.PLAY))
        until(lambda: at_s() >= recording.end_s)
        assert state.report.content == final
        player.run(Command(Action.PLAY))
        until(lambda: at_s() < recording.end_s)
        player.run(Command(Action.PAUSE))
        with pytest.raises(InputError, match="no nodes"):
            player.run(Command(Action.RESET, "mapping_node"))
    assert "recording" not in state.nodes


def test_a_run_brings_its_truth_and_limits_wherever_it_is_opened(
    source: Path, out: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    moved = tmp_path / "campaign"
    shutil.copytree(source, moved / "data")
    shutil.copytree(out, moved / "runs" / "out")
    monkeypatch.chdir(moved)
    limits = parse_limits({"trajectory": [{"condition": "frames=5", "position_mean_plus_3sigma_m": 1e-6}]}, "x")
    inputs = ScoreInputs.of(Path("runs/out/estimate.csv"), Path("data"), ())
    (moved / "runs" / "out" / "report.json").write_text(to_json(score_files(inputs, CONFIG, limits)))
    for folder in (moved, tmp_path, moved / "runs" / "out"):
        monkeypatch.chdir(folder)
        recording = open_recording(moved / "runs" / "out")
        assert recording.source is not None
        assert recording.limits is not None
        assert (recording.note, recording.limits.limits) == ("", limits.limits)
        assert recording.settings["trajectory.spacing"] == 3
    state = LiveState()
    player = Player(state, recording, build(ScoreConfig, recording.settings), recording.limits)
    assert {"tracking", "degraded", "lost"} == {event["kind"] for event in state.events_to_plain()}
    player.advance(2.0)
    player.report()
    assert state.report is not None
    assert state.report.overall.state == "fail"
    assert state.to_plain(time.time())["association"]["estimate_poses"] == 21, "as of then"
    assert "limit" in [event["kind"] for event in state.events_to_plain()]
    assert all(
        topic["rate_hz"] is None or topic["rate_hz"] < 11 for topic in state.to_plain(0.0)["live"]["topics"].values()
    )
    (moved / "data" / "loc" / "groundtruth.csv").write_text("changed")
    assert "give --truth" in open_recording(moved / "runs" / "out").note


def test_a_data_set_shows_images_and_truth_and_nothing_else_is_refused(source: Path, tmp_path: Path) -> None:
    recording = open_recording(source)
    _, topic, stamp_ns, image = next(iter(recording.frames()))
    assert (topic, stamp_ns, image.shape) == ("loc/left", START_NS, (120, 160))
    assert len(recording.moments) == COUNT
    with pytest.raises(InputError):
        open_recording(tmp_path)
