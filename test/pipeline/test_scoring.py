"""The command `sfr score` and what lies behind it, on small files with known answers."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer

from sfr_loc_map.cli.main import main
from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.bag import TYPESTORE
from sfr_loc_map.io.bag_messages import header, odometry
from sfr_loc_map.io.cloud_file import save_cloud
from sfr_loc_map.io.trajectory_file import save_trajectory
from sfr_loc_map.metrics.config import MappingState, ScoreConfig
from sfr_loc_map.metrics.score import FindingKind, MethodKind, MethodRecord
from sfr_loc_map.metrics.score_json import from_json, to_json
from sfr_loc_map.pipeline.bag_estimates import DIAGNOSTICS
from sfr_loc_map.pipeline.call_stats import CallRecord, load_call_stats, save_stats
from sfr_loc_map.pipeline.scoring import Run, ScoreInputs, estimates_of, load_estimates, score_run

WIDTH, HEIGHT, FOCAL = 64, 48, 60.0


def straight(count: int = 300, scale: float = 1.0) -> Trajectory:
    positions = np.column_stack((0.1 * scale * np.arange(count), np.zeros((count, 2))))
    return Trajectory(np.arange(count) * 100_000_000, positions, np.tile([0.0, 0.0, 0.0, 1.0], (count, 1)))


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    """An estimate that is 1 % short, and the truth."""
    estimate, truth = tmp_path / "estimate.txt", tmp_path / "truth.csv"
    save_trajectory(estimate, straight(scale=0.99))
    save_trajectory(truth, straight())
    return estimate, truth


def run(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    monkeypatch.setattr(sys, "argv", ["sfr", *map(str, arguments)])
    return main()


def scored(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, *arguments: object) -> dict[str, Any]:
    assert run(monkeypatch, "score", *arguments, "--json", tmp_path / "score.json", "--overwrite") == 0
    return dict(json.loads((tmp_path / "score.json").read_text()))


def test_score_of_trajectory_files(
    files: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    score = scored(monkeypatch, tmp_path, *files)
    trajectory = score["trajectory"]
    assert score["schema"] == "sfr-score/1"
    assert (trajectory["count"], trajectory["matched"], trajectory["estimate_poses"]) == (25, 300, 300)
    assert trajectory["condition"] == {"distance_m": 5.0}
    assert trajectory["position_m"]["mean"] == pytest.approx(0.05)
    assert trajectory["position_m"]["sigma"] == pytest.approx(0.0, abs=1e-12)
    assert set(score["provenance"]["inputs"]) == {"estimate", "truth"}
    assert "position error over 5 m" in capsys.readouterr().out


@pytest.mark.parametrize(("limit", "code"), [(0.06, 0), (0.04, 1)])
def test_exit_code_is_the_verdict(
    files: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limit: float, code: int
) -> None:
    limits = tmp_path / "limits.yaml"
    limits.write_text(f"trajectory:\n  - condition: distance=2\n    position_mean_plus_3sigma_m: {limit / 2.5}\n")
    assert run(monkeypatch, "score", *files, "--limits", limits, "--json", tmp_path / "s.json") == code
    score = json.loads((tmp_path / "s.json").read_text())
    assert score["verdicts"][0]["verdict"] == ("fail" if code else "pass")
    assert score["trajectory"]["condition"] == {"distance_m": 5.0}


def test_statistics_bring_states_times_and_memory(
    files: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stats = tmp_path / "stats.csv"
    lines = ["stamp_ns,processing_time_s,state,reason,peak_rss_bytes"]
    states = ["lost,few_landmarks"] * 10 + ["degraded,unseen_motion"] * 3 + ["tracking,"] * 287
    lines += [f"{k * 100_000_000},0.0{k % 3 + 1},{state},1000" for k, state in enumerate(states)]
    stats.write_text("\n".join(lines) + "\n")
    score = scored(monkeypatch, tmp_path, *files, "--stats", stats)
    assert (score["trajectory"]["lost"], score["trajectory"]["degraded"]) == (10, 3)
    assert score["timing"]["localisation_s"]["max"] == 0.03
    assert score["memory"]["localisation_peak_bytes"] == 1000
    assert score["memory"]["localisation_above_idle_bytes"] is None


def test_a_file_of_calls_holds_each_step_to_the_last_bit(tmp_path: Path) -> None:
    step, path = np.random.default_rng(0).normal(size=27) / 3.0, tmp_path / "stats.csv"
    call, pose = (0.1, "tracking", None, None), {"covariance": np.eye(6)}
    save_stats(path, [CallRecord(0, *call, **pose), CallRecord(100_000_000, *call, **pose, step=step)])
    found = load_call_stats(path).estimates(straight(3)).steps
    assert found is not None
    np.testing.assert_array_equal(found, [np.full(27, np.nan), step, np.full(27, np.nan)])


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ("0,-1.0,tracking,1000", "line 2: processing_time_s is -1: 0 to"),
        ("0,inf,tracking,1000", "line 2: processing_time_s is inf: 0 to"),
        ("0,0.1,tracking,-5", "line 2: peak_rss_bytes is -5: 0 to"),
        ("0,0.1,LOST,1000", "line 2: state is 'LOST', must be one of initialising, tracking"),
    ],
)
def test_times_sizes_and_states_that_cannot_be_are_refused(tmp_path: Path, row: str, words: str) -> None:
    path = tmp_path / "stats.csv"
    path.write_text(f"stamp_ns,processing_time_s,state,peak_rss_bytes\n{row}\n")
    with pytest.raises(InputError, match=words):
        load_call_stats(path)


def test_calls_of_another_drive_are_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "stats.csv"
    path.write_text("stamp_ns,state\n5,lost\n")
    poses = Trajectory(np.array([6]), np.zeros((1, 3)), np.array([[0.0, 0.0, 0.0, 1.0]]))
    assert not estimates_of(poses, [load_call_stats(path)]).lost.any()
    assert "no call of the statistics has the stamp of an estimate" in caplog.text


def test_calls_of_a_mapper_at_the_same_stamps_hide_none_of_the_localiser(tmp_path: Path) -> None:
    path, poses = tmp_path / "stats.csv", straight(2)
    calls = [CallRecord(stamp, 0.1, "degraded", None, None, covariance=np.eye(6)) for stamp in poses.stamps_ns.tolist()]
    save_stats(path, [*calls, *(CallRecord(100_000_000, 0.1, state, None, None) for state in MappingState)])
    found = load_call_stats(path).estimates(poses)
    assert found.covariance is not None
    assert np.isfinite(found.covariance).all()
    assert found.degraded.all()


def test_times_of_a_target_stand_under_its_name(
    files: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    target, limits = tmp_path / "target.csv", tmp_path / "limits.yaml"
    target.write_text("processing_time_s,peak_rss_bytes\n1.5,1000\n2.5,3000\n")
    limits.write_text("target:\n  localisation_max_s: 2.0\n  localisation_peak_bytes: 5000\n")
    arguments = ("--target", "GR740", "--target-timing", target, "--limits", limits, "--json", tmp_path / "s.json")
    assert run(monkeypatch, "score", *files, *arguments) == 1
    score = json.loads((tmp_path / "s.json").read_text())
    assert "timing" not in score
    assert score["target"]["name"] == "GR740"
    assert score["target"]["timing"]["localisation_s"]["clock"] == "GR740"
    assert [item["verdict"] for item in score["verdicts"]] == ["fail", "pass"]
    assert "Clock: GR740." in capsys.readouterr().out
    assert run(monkeypatch, "score", *files, "--target-timing", target) == 2


@pytest.mark.parametrize("name", ["estimate.mcap", "estimate.db3"])
def test_bags_score_as_the_files_they_were_made_of(
    files: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    assert run(monkeypatch, "convert", files[0], tmp_path / name) == 0
    assert run(monkeypatch, "convert", files[1], tmp_path / f"truth_{name}") == 0
    by_bag = scored(monkeypatch, tmp_path, tmp_path / name, tmp_path / f"truth_{name}")
    assert by_bag["trajectory"] == scored(monkeypatch, tmp_path, *files)["trajectory"]


@pytest.fixture
def nav_set(tmp_path: Path) -> tuple[Path, PointCloud]:
    """A data set with one pair that looks at a wall 5 m away, and the cloud of the wall at 5.1 m."""
    folder = tmp_path / "nav"
    for name in ("left", "right", "truth"):
        (folder / name).mkdir(parents=True)
    cv2.imwrite(str(folder / "left/0.png"), np.zeros((HEIGHT, WIDTH), np.uint8))
    cv2.imwrite(str(folder / "right/0.png"), np.zeros((HEIGHT, WIDTH), np.uint8))
    k = [FOCAL, 0, 31.5, 0, FOCAL, 23.5, 0, 0, 1]
    (folder / "rig.json").write_text(json.dumps({"width": WIDTH, "height": HEIGHT, "k": k, "baseline_m": 0.2}))
    pose = [f"navsbOriginPos_m_Lm_{a}" for a in "xyz"] + [f"att_q_LmToNavsb_{i}" for i in (1, 2, 3, 4)]
    header = ",".join(["stamp_ns", "left", "right", *pose, "truth"])
    (folder / "pairs.csv").write_text(f"{header}\n5,left/0.png,right/0.png,0,0,0,0,0,0,1,truth/0.npy\n")
    u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    forward = np.full(u.shape, 5.0)
    wall = np.stack((forward, 0.1 - (u - 31.5) / FOCAL * 5.0, -(v - 23.5) / FOCAL * 5.0), axis=-1).astype(np.float32)
    np.save(folder / "truth/0.npy", wall)
    records = np.zeros(u.size, PointCloud.dtype())
    for axis, name in enumerate("xyz"):
        records[name] = wall[..., axis].ravel()
    records["x"] += np.float32(0.1)
    records["sigma"] = 0.1
    records["u"], records["v"] = u.ravel(), v.ravel()
    return folder, PointCloud.from_structured(records, fused=False)


@pytest.mark.parametrize("suffix", [".ply", ".pcd", ".npz"])
def test_score_of_cloud_files(
    nav_set: tuple[Path, PointCloud], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str
) -> None:
    folder, cloud = nav_set
    save_cloud(tmp_path / f"cloud{suffix}", cloud)
    part = scored(monkeypatch, tmp_path, tmp_path / f"cloud{suffix}", folder)["map"]
    assert (part["pairs"], part["points"], part["coverage"]) == (1, WIDTH * HEIGHT, 1.0)
    assert part["point_error_m"]["mean"] == pytest.approx(0.1, abs=1e-6)


def test_a_cloud_file_without_its_kind_needs_the_option_and_one_with_it_is_not_contradicted(
    nav_set: tuple[Path, PointCloud],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder, cloud = nav_set
    silent, path = tmp_path / "silent.ply", tmp_path / "cloud.ply"
    save_cloud(silent, replace(cloud, fused=None))
    save_cloud(path, cloud)
    assert run(monkeypatch, "score", silent, folder) == 2
    assert "does not say whether it is fused: give --fused" in capsys.readouterr().err
    kinds = [
        scored(monkeypatch, tmp_path, silent, folder, option)["map"]["cloud"] for option in ("--fused", "--not-fused")
    ]
    assert kinds == ["fused", "single pairs"]
    assert scored(monkeypatch, tmp_path, path, folder, "--not-fused")["map"]["cloud"] == "single pairs"
    capsys.readouterr()
    assert run(monkeypatch, "score", path, folder, "--fused") == 2
    assert "says that it is not fused" in capsys.readouterr().err


def test_bad_input_is_one_line_and_leaves_nothing(
    files: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    broken = tmp_path / "broken.txt"
    broken.write_text("0 0 0 0 0 0 0 nan\n")
    limits = tmp_path / "limits.yaml"
    limits.write_text("position: 3\n")
    other = tmp_path / "other.txt"
    save_trajectory(other, Trajectory(np.array([10**18]), np.zeros((1, 3)), np.array([[0.0, 0, 0, 1]])))
    for arguments in (
        (broken, files[1]),
        (tmp_path / "missing.txt", files[1]),
        (other, files[1]),
        (*files, "--condition", "5m"),
        (*files, "--spacing", "0"),
        (*files, "--rebase", "se3"),
        (*files, "--limits", limits),
        (*files, "--stats", files[1].with_name("none.csv")),
    ):
        capsys.readouterr()
        assert run(monkeypatch, "score", *arguments, "--json", tmp_path / "s.json") == 2
        error = capsys.readouterr().err
        assert error.count("\n") == 1
        assert error.startswith("sfr: ")
        assert not (tmp_path / "s.json").exists()


def winding() -> Trajectory:
    yaw = 2.0 * np.sin(np.arange(300) / 30.0)
    positions = np.cumsum(np.column_stack((0.1 * np.cos(yaw), 0.1 * np.sin(yaw), 0 * yaw)), axis=0)
    quats = np.column_stack((0 * yaw, 0 * yaw, np.sin(yaw / 2), np.cos(yaw / 2)))
    return Trajectory(np.arange(300) * 100_000_000, positions, quats)


def test_a_wrong_convention_is_warned_of_and_the_doctor_finds_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    truth = winding()
    wrong = Trajectory(truth.stamps_ns, truth.positions, truth.quats_xyzw * [-1, -1, -1, 1])
    late = Trajectory(truth.stamps_ns + 10**12, truth.positions, truth.quats_xyzw)
    for name, content in (("truth", truth), ("wrong", wrong), ("late", late)):
        save_trajectory(tmp_path / f"{name}.tum", content)
    assert run(monkeypatch, "score", tmp_path / "wrong.tum", tmp_path / "truth.tum", "--json", "-") == 3
    captured = capsys.readouterr()
    assert "conjugated" in json.loads(captured.out)["warnings"][0]
    assert captured.err.count("\n") == 1
    assert captured.err.startswith("sfr: not judged: the estimate looks wrong: ")
    assert run(monkeypatch, "score", tmp_path / "truth.tum", tmp_path / "truth.tum", "--json", "-") == 0
    captured = capsys.readouterr()
    assert "warnings" not in json.loads(captured.out)
    assert captured.err == ""
    assert run(monkeypatch, "doctor", tmp_path / "wrong.tum", tmp_path / "truth.tum", "--json", "-") == 1
    assert json.loads(capsys.readouterr().out)["found"]["mistake"] == "conjugated quaternion"
    assert run(monkeypatch, "doctor", tmp_path / "late.tum", tmp_path / "truth.tum") == 1
    assert "-1000.000 s" in capsys.readouterr().out
    assert run(monkeypatch, "doctor", tmp_path / "truth.tum", tmp_path / "truth.tum") == 0
    assert "no single convention mismatch" in capsys.readouterr().out


def test_the_statistics_name_the_method_and_what_it_did_wrong(tmp_path: Path) -> None:
    call = ("tracking", 1000, 10)
    findings = ("", "crashed: ended by signal 11", "", "crashed: again", "not finite: position", "no finding")
    records = [CallRecord(stamp, 0.1, *call, finding=text) for stamp, text in enumerate(findings)]
    method = MethodRecord(name="lib:made.so", version="3", kind=MethodKind.LIBRARY, sha256="ab")
    save_stats(tmp_path / "stats.csv", records, method)
    stats = load_call_stats(tmp_path / "stats.csv")
    assert stats.method == method
    score = score_run(Run(ScoreInputs(), [stats]), ScoreConfig())
    again = from_json(to_json(score))
    assert again.method == method
    assert [(item.kind, item.count, item.first_stamp_ns, item.text) for item in again.findings] == [
        (FindingKind.CRASHED, 2, 1, "ended by signal 11"),
        (FindingKind.NOT_FINITE, 1, 4, "position"),
    ]


STEP = np.random.default_rng(0).normal(size=27) / 3.0


def status(name: str, **values: object) -> object:
    """Return a status as nodes write them."""
    types = TYPESTORE.types
    pairs = [types["diagnostic_msgs/msg/KeyValue"](key, str(value)) for key, value in values.items()]
    return types["diagnostic_msgs/msg/DiagnosticStatus"](0, name, "", "host", pairs)


def call(node: str, stamp_ns: object, state: str, **more: object) -> object:
    """Return the status of a call."""
    return status(f"{node}: call", task="localisation", stamp_ns=stamp_ns, state=state, processing_time_s=0.1, **more)


def recorded(path: Path, *statuses: object, namespace: str = "/rover") -> Path:
    """Write a bag with three estimates and these statuses."""
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        poses = writer.add_connection(
            f"{namespace}/localisation/odometry", "nav_msgs/msg/Odometry", typestore=TYPESTORE
        )
        told = writer.add_connection("/diagnostics", DIAGNOSTICS, typestore=TYPESTORE)
        for stamp_ns in (1, 2, 3):
            message = odometry(stamp_ns, np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
            writer.write(poses, stamp_ns, TYPESTORE.serialize_cdr(message, "nav_msgs/msg/Odometry"))
        for item in statuses:
            array = TYPESTORE.types[DIAGNOSTICS](header(1, ""), [item])
            writer.write(told, 3, TYPESTORE.serialize_cdr(array, DIAGNOSTICS))
    return path


def test_a_bag_has_the_states_and_steps_of_its_node(tmp_path: Path) -> None:
    text = " ".join(map(repr, STEP.tolist()))
    bag = recorded(
        tmp_path / "bag",
        call("rover/localisation_node", 1, "tracking"),
        call("rover/localisation_node", 3, "degraded", step=text),
        call("other/localisation_node", 2, "degraded", step=text),
        status("rover/localisation_node: summary", task="localisation"),
        status("rover/mapping_node: call", task="mapping", stamp_ns=2, state="degraded", processing_time_s=1),
    )
    found = load_estimates(bag)
    assert found.degraded.tolist() == [False, False, True]
    assert found.steps is not None
    np.testing.assert_array_equal(found.steps, [np.full(27, np.nan)] * 2 + [STEP])


def test_a_call_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="'localisation_node: call' of '/diagnostics'"):
        load_estimates(recorded(tmp_path / "bag", call("localisation_node", "later", "tracking"), namespace=""))
