"""The command `sfr score` and what lies behind it, on small files with known answers."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers import score_rows
from helpers.cli_result import Sfr
from helpers.made_scene import NAV_RIG, nav_pair, write_folder
from helpers.message_bags import write_messages
from helpers.scored_drives import PERIOD_NS, straight
from sfr_loc_map.calls.call_files import load_call_stats, save_stats
from sfr_loc_map.calls.call_message import encode_call
from sfr_loc_map.calls.call_poses import estimates_of
from sfr_loc_map.calls.call_record import CallRecord
from sfr_loc_map.calls.growing_calls import stats_of
from sfr_loc_map.calls.run_identity import RunIdentity
from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.trajectory import Trajectory, Truth
from sfr_loc_map.io.bag.encoding import TYPESTORE
from sfr_loc_map.io.bag.messages import odometry
from sfr_loc_map.io.clouds.cloud_file import save_cloud
from sfr_loc_map.io.tables.trajectory_writer import save_trajectory
from sfr_loc_map.message_types import STRING
from sfr_loc_map.metrics.calls.call_meter import HOST_CLOCK
from sfr_loc_map.metrics.calls.call_score import STATED_BY_NODE
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.metrics.judging.limits_file import parse_limits
from sfr_loc_map.scoring.inputs import InMemory, Run, ScoreInputs
from sfr_loc_map.scoring.load import load_run
from sfr_loc_map.scoring.load_calls import estimates_of_calls
from sfr_loc_map.scoring.load_trajectories import load_estimates
from sfr_loc_map.scoring.provenance import hash_of_truth
from sfr_loc_map.scoring.score_run import score_run
from sfr_loc_map.suite_names import Task

Scored = Callable[..., dict[str, Any]]


@pytest.fixture
def scored(sfr: Sfr) -> Scored:
    def score(*arguments: object) -> dict[str, Any]:
        done = sfr("score", *arguments, "--json", "-")
        assert done.code == 0, done.err
        return dict(json.loads(done.out))

    return score


def test_ground_truths_with_other_attitudes_or_sigmas_have_other_hashes(tmp_path: Path, scored: Scored) -> None:
    """The positions are equal."""
    estimate, given = tmp_path / "estimate.csv", straight()
    save_trajectory(estimate, given)
    turned = np.tile([0.0, 0.0, np.sin(0.1), np.cos(0.1)], (len(given), 1))
    hashes = []
    for name, quats in (("first", given.quats_xyzw), ("same", given.quats_xyzw), ("turned", turned)):
        truth = tmp_path / f"{name}.csv"
        save_trajectory(truth, Trajectory(given.stamps_ns, given.positions, quats))
        hashes.append(scored(estimate, truth)["provenance"]["inputs"]["truth"]["data_sha256"])
    assert hashes[0] == hashes[1] != hashes[2]
    poses = given.stamps_ns, given.positions, given.quats_xyzw
    others = Truth(*poses), Truth(*poses, sigma_m=0.01), Truth(*poses, sigma_deg=0.01)
    assert len({hash_of_truth(truth) for truth in others}) == 3


def test_score_of_trajectories_in_files_and_bags_with_their_calls(tmp_path: Path, scored: Scored, sfr: Sfr) -> None:
    """The estimate is 1 % short."""
    files, stats = (tmp_path / "estimate.txt", tmp_path / "truth.csv"), tmp_path / "stats.csv"
    for file, scale in zip(files, (0.99, 1.0), strict=True):
        save_trajectory(file, straight(scale=scale))
    states = ["lost,few_landmarks"] * 10 + ["degraded,unseen_motion"] * 3 + ["tracking,"] * 287
    lines = [f"{k * PERIOD_NS},0.0{k % 3 + 1},{state},1000" for k, state in enumerate(states)]
    stats.write_text("\n".join(["stamp_ns,processing_time_s,state,reason,peak_rss_bytes", *lines]) + "\n")
    score = scored(*files)
    figures, poses = score["figures"], score["association"]
    assert (score["schema"], set(score["provenance"]["inputs"])) == ("sfr-score/2", {"estimate", "truth"})
    assert (poses["matched"], poses["estimate_poses"]) == (300, 300)
    position = score_rows.row(score, "position", condition="distance=5", part="pose")
    assert position["n"] == 25
    assert position["mean"] == pytest.approx(0.05)
    assert position["sigma"] == pytest.approx(0.0, abs=1e-12)
    assert "position error over 5 m" in sfr("score", *files).out
    score = scored(*files, "--condition", "time=3", "--condition", "frames=7", "--stats", stats)
    conditions = [
        item["condition"] for item in score["figures"] if item["figure"] == "chord" and item.get("part") == "pose"
    ]
    assert conditions == ["time=3", "frames=7"]
    assert (score["association"]["lost"], score["association"]["degraded"]) == (10, 3)
    assert score_rows.number(score, "lost") == pytest.approx(10 / 300)
    assert score_rows.number(score, "localisation", "max") == 0.03
    assert [score_rows.number(score, name, part="localisation") for name in ("peak", "above_idle")] == [1000, None]
    bags = [tmp_path / "estimate.mcap", tmp_path / "truth.db3"]
    assert [sfr("convert", *pair).code for pair in zip(files, bags, strict=True)] == [0, 0]
    assert scored(*bags)["figures"] == figures


def test_calls_that_cannot_be_are_refused_and_those_of_another_drive_told(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "stats.csv"
    for row, words in (
        ("0,-1.0,tracking,1000", "line 2: processing_time_s is -1: 0 to"),
        ("0,inf,tracking,1000", "line 2: processing_time_s is inf: 0 to"),
        ("0,0.1,LOST,1000", "line 2: state is 'LOST': one of initialising, tracking"),
    ):
        path.write_text(f"stamp_ns,processing_time_s,state,peak_rss_bytes\n{row}\n")
        with pytest.raises(InputError, match=words):
            load_call_stats(path)
    path.write_text("stamp_ns,state\n5,lost\n")
    assert not estimates_of_calls(straight(3), [load_call_stats(path)]).lost.any()
    assert "has the stamp of a pose of the estimate, so the lost poses are unknown" in caplog.text


def test_a_cloud_file_without_its_kind_needs_the_option_and_one_with_it_is_not_contradicted(
    tmp_path: Path, scored: Scored, sfr: Sfr
) -> None:
    """The cloud is the true points of one pair, 0.1 m further away."""
    folder, silent, path = write_folder(tmp_path / "nav", 0, 1), tmp_path / "silent.ply", tmp_path / "cloud.ply"
    xyz = nav_pair(0).truth.reshape(-1, 3) + np.float32([0.1, 0.0, 0.0])
    v, u = np.indices((NAV_RIG.height, NAV_RIG.width), np.uint16).reshape(2, -1)
    ones = np.ones(len(xyz), np.float32)
    cloud = PointCloud(xyz, 0.1 * ones, ones, u, v, np.zeros(len(xyz), np.uint8), fused=False)
    save_cloud(silent, replace(cloud, fused=None))
    save_cloud(path, cloud)
    score = scored(path, folder)
    assert [score_rows.number(score, name) for name in ("pairs", "points", "coverage")] == [1, len(xyz), 1.0]
    assert score_rows.number(score, "point_error", "mean") == pytest.approx(0.1, abs=1e-6)
    assert (
        "does not declare whether it is fused, which changes the coverage: give --fused"
        in sfr("score", silent, folder).err
    )
    kinds = [scored(silent, folder, option)["cloud"]["kind"] for option in ("--fused", "--not-fused")]
    assert kinds == ["fused", "single pairs"]
    assert scored(path, folder, "--not-fused")["cloud"]["kind"] == "single pairs"
    done = sfr("score", path, folder, "--fused")
    assert (done.code, "declares that it is not fused" in done.err) == (2, True)


def recorded(path: Path, calls: Mapping[str, Sequence[str]]) -> Path:
    """Write a bag with three estimates of a rover, and calls as JSON by their topic."""
    entries: list[tuple[str, int, Any]] = []
    for stamp_ns in (1, 2, 3):
        message = odometry(stamp_ns, np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
        entries.append(("/rover/localisation/odometry", stamp_ns, message))
    for topic, texts in calls.items():
        entries += [(topic, 3, TYPESTORE.types[STRING](text)) for text in texts]
    return write_messages(path, entries)


def test_a_bag_has_the_states_and_steps_of_its_node(tmp_path: Path) -> None:
    step = np.abs(np.random.default_rng(0).normal(size=48)) / 3.0
    degraded = CallRecord(3, 0.1, "degraded", step=step)
    calls = {
        "/rover/localisation_node/call": [encode_call(CallRecord(1, 0.1, "tracking")), encode_call(degraded)],
        "/other/localisation_node/call": [encode_call(replace(degraded, stamp_ns=2))],
        "/rover/mapping_node/call": [encode_call(replace(degraded, stamp_ns=2))],
    }
    found = load_estimates(recorded(tmp_path / "bag", calls))
    assert found.degraded.tolist() == [False, False, True]
    np.testing.assert_array_equal(found.steps, [np.full(48, np.nan)] * 2 + [step])
    silent = load_estimates(recorded(tmp_path / "silent", {}))
    assert (silent.degraded.any(), silent.steps) == (False, None)
    with pytest.raises(InputError, match="'/rover/localisation_node/call'"):
        load_estimates(recorded(tmp_path / "broken", {"/rover/localisation_node/call": ['{"stamp_ns": "later"}']}))


@pytest.mark.parametrize("of_calls", [None, 4.0, 9999.0])
@pytest.mark.parametrize(("published", "lost"), [((9999.0, 1e-4), 10), ((0.0, 1e-4), 0), ((1e-4, 1e-4), 0), (None, 0)])
def test_covariances_and_lost_poses_of_a_file_are_those_of_a_bag(
    tmp_path: Path, published: tuple[float, float] | None, lost: int, of_calls: float | None
) -> None:
    """The first ten poses have one variance, the others another. A covariance of zeros is unknown."""
    poses = straight(60)
    variances = np.zeros(60) if published is None else np.repeat(published, (10, 50))
    header, matrix = "# time tx ty tz qx qy qz qw", np.array([1, 0, 0, 1, 0, 1, 1, 0, 0, 1, 0, 1])
    entries, lines = [], []
    for stamp_ns, at, quat, variance in zip(
        poses.stamps_ns.tolist(), poses.positions, poses.quats_xyzw, variances.tolist(), strict=True
    ):
        message = odometry(stamp_ns, at, quat)
        message.pose.covariance[::7] = variance
        entries.append(("/localisation/odometry", stamp_ns, message))
        of_file = [] if published is None else (variance * matrix).tolist()
        lines.append(" ".join(map(str, [stamp_ns / 1e9, *at, *quat, *of_file])))
    columns = "" if published is None else " Pr11 Pr12 Pr13 Pr22 Pr23 Pr33 Pt11 Pt12 Pt13 Pt22 Pt23 Pt33"
    (tmp_path / "estimate.txt").write_text("\n".join([header + columns, *lines]) + "\n")
    write_messages(tmp_path / "bag", entries)
    calls = []
    if of_calls is not None:
        records = [CallRecord(k, 0.1, "tracking", covariance=of_calls * np.eye(6)) for k in poses.stamps_ns.tolist()]
        calls = [stats_of(records)]
    read = []
    for path in (tmp_path / "estimate.txt", tmp_path / "bag"):
        run = load_run(ScoreInputs(estimate=path), in_memory=InMemory(truth=poses, calls=calls))
        assert run.drive is not None
        read.append(run.drive.estimates)
        if of_calls is None:
            read.append(load_estimates(path))
    if of_calls == 9999.0 and (published is None or published[0] == 0.0):
        lost = 60 if published is None else 10
    for found in read:
        assert np.count_nonzero(found.lost) == lost
        np.testing.assert_array_equal(found.is_lost_known, read[0].is_lost_known)
        assert (found.covariance is None) == (published is None and of_calls is None)
        if found.covariance is not None:
            np.testing.assert_array_equal(found.covariance, read[0].covariance)


def test_a_bag_without_calls_has_the_states_of_the_given_calls_which_must_be_its_own(tmp_path: Path) -> None:
    inputs, truth = ScoreInputs(estimate=recorded(tmp_path / "bag", {})), straight(3)
    truth = replace(truth, stamps_ns=np.array([1, 2, 3]))
    records = [CallRecord(stamp, 0.1, state) for stamp, state in ((1, "tracking"), (2, "lost"), (3, "tracking"))]
    calls = replace(stats_of(records), identity=RunIdentity(np.zeros((3, 3))))
    run = load_run(inputs, in_memory=InMemory(truth=truth, calls=[calls]))
    assert run.drive is not None
    assert run.drive.estimates.lost.tolist() == [False, True, False]
    other = replace(calls, identity=RunIdentity(np.ones((3, 3))))
    with pytest.raises(InputError, match="belong to another estimate"):
        load_run(inputs, in_memory=InMemory(truth=truth, calls=[other]))


@pytest.mark.parametrize("is_rounded", [False, True])
def test_poses_with_rounded_stamps_have_the_states_and_steps_of_their_calls(tmp_path: Path, is_rounded: bool) -> None:
    """A TUM file has stamps of microseconds. A pose is missing from the estimate, and two calls have one stamp."""
    stamps = (1_700_000_000_000_000_000 + 100_000_123 * np.arange(6)).tolist()
    states = ["tracking", "lost", "tracking", "degraded", "tracking", "tracking"]
    records = [CallRecord(at, 0.1, state, step=np.ones(48)) for at, state in zip(stamps, states, strict=True)]
    records.append(CallRecord(stamps[4], 0.1, "degraded", step=np.ones(48)))
    kept = [0, 1, 3, 4, 5]
    given_ns = np.array(stamps)[kept]
    if is_rounded:
        given_ns = (given_ns + 500) // 1000 * 1000
    poses = Trajectory(given_ns, np.zeros((5, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (5, 1)))
    found = estimates_of_calls(poses, [stats_of(records)])
    assert found.is_lost_known.all()
    assert found.lost.tolist() == [False, True, False, False, False]
    assert found.degraded.tolist() == [False, False, True, True, False]
    assert found.steps is not None
    assert np.isfinite(found.steps).all(axis=1).tolist() == [True, True, False, True, True]
    keyframes = poses[::2]
    assert not estimates_of_calls(keyframes, [stats_of(records)]).lost.any()


def test_the_calls_of_a_bag_are_those_of_the_run(tmp_path: Path) -> None:
    """Times are judged, and a crash fails the score; calls of a localiser that are given, too, would count twice."""
    records = [CallRecord(stamp, 0.1, "tracking", finding="crashed: dead" if stamp == 3 else "") for stamp in (1, 2, 3)]
    path = recorded(tmp_path / "bag", {"/rover/localisation_node/call": [encode_call(each) for each in records]})
    truth = replace(straight(3), stamps_ns=np.array([1, 2, 3]))
    inputs = ScoreInputs(estimate=path)
    run = load_run(inputs, in_memory=InMemory(truth=truth))
    limits = parse_limits({"timing": {"localisation_max_s": 1.0}}, "limits")
    score = score_run(run, ScoreConfig(), limits)
    assert [item.kind for item in score.findings] == ["crashed"]
    assert score.verdict == "fail"
    assert [item.state for item in score.on_limits if item.name == "localisation_max_s"] != ["not enough data"]
    assert score.calls is not None
    assert score.calls.clocks == {"localisation": "stated by the node"}
    mapped = stats_of([CallRecord(1, 0.1, "mapped")])
    assert len(load_run(inputs, in_memory=InMemory(truth=truth, calls=[mapped])).stats) == 2
    with pytest.raises(InputError, match="give the calls once"):
        load_run(inputs, in_memory=InMemory(truth=truth, calls=[stats_of(records)]))


@pytest.mark.parametrize("is_mapper_stated", [False, True])
@pytest.mark.parametrize("is_localiser_stated", [None, False, True])
def test_only_the_calls_of_a_node_have_a_stated_clock(is_localiser_stated: bool | None, is_mapper_stated: bool) -> None:
    """Calls of a bag were stated by the node. Calls of a file were measured."""
    mapped = [CallRecord(k, 0.1, state) for k, state in enumerate(("mapped", "fused"))]
    stats = [stats_of(mapped, stated_tasks=(Task.MAPPING,) if is_mapper_stated else ())]
    is_stated = dict.fromkeys(("mapping", "fusion"), is_mapper_stated)
    if is_localiser_stated is not None:
        stated_tasks = (Task.LOCALISATION,) if is_localiser_stated else ()
        stats.append(stats_of([CallRecord(1, 0.1, "tracking")], stated_tasks=stated_tasks))
        is_stated["localisation"] = is_localiser_stated
    score = score_run(Run(stats=stats), ScoreConfig())
    assert score.calls is not None
    assert score.calls.clocks == {kind: STATED_BY_NODE if stated else HOST_CLOCK for kind, stated in is_stated.items()}


def test_a_method_does_not_tell_its_own_cost(tmp_path: Path) -> None:
    told = {
        "processing_time_s": 0.001,
        "peak_rss_bytes": 1.0,
        "state": 2.0,
        "finding": np.nan,
        "cov_00": 1.0,
        "own": 7.0,
    }
    save_stats(tmp_path / "s.csv", [CallRecord(5, 0.4, "tracking", peak_rss_bytes=2 * 10**8, statistics=told)])
    calls = load_call_stats(tmp_path / "s.csv").calls
    assert (calls.seconds.tolist(), calls.peak_bytes.tolist(), list(calls.states)) == ([0.4], [2e8], ["tracking"])
    header = (tmp_path / "s.csv").read_text().splitlines()[0].split(",")
    assert len({*header}) == len(header)
    assert "own" in header


def test_steps_from_poses_that_are_left_out_are_not_known(tmp_path: Path) -> None:
    records = [CallRecord(stamp, 0.1, "tracking", step=np.ones(48)) for stamp in range(10, 16)]
    save_stats(tmp_path / "s.csv", [replace(record, covariance=np.eye(6)) for record in records])
    rows = [0, 1, 3, 4]
    poses = Trajectory(np.arange(10, 16)[rows], np.zeros((4, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (4, 1)))
    steps = estimates_of(poses, load_call_stats(tmp_path / "s.csv")).steps
    assert steps is not None
    assert np.isfinite(steps).all(axis=1).tolist() == [True, True, False, True]
