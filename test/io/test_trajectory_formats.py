"""Trajectories of other tools: every format is detected, read back to the same poses, and wrong lines are named."""

from __future__ import annotations

import io
import json
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cli_result import Sfr

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.rotation import matrix_from_rotvec, quat_from_matrix
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.trajectory_file import (
    TrajectoryFormat,
    read_trajectory_file,
    save_trajectory,
    trajectory_text,
)

FILES = {"t.csv": "csv", "t.tum": "tum", "t.txt": "tum", "t.kitti": "kitti", "t.euroc.csv": "euroc"}


def curve(count: int = 30) -> Trajectory:
    """Return a drive in a curve: forward, to the left and slightly up."""
    angle = np.linspace(0.0, 1.2, count)
    positions = np.column_stack((5 * np.sin(angle), 5 - 5 * np.cos(angle), 0.1 * angle))
    quats = np.array([quat_from_matrix(matrix_from_rotvec([0.02 * a, -0.01, a])) for a in angle])
    stamps = 1_700_000_000_123_456_789 + np.arange(count, dtype=np.int64) * 100_000_001
    return Trajectory(stamps, positions, quats)


def evo_zip(path: Path, members: dict[str, str], est: str = "est.txt", ref: str = "ref.txt") -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("info.json", json.dumps({"title": "APE", "est_name": est, "ref_name": ref}))
        archive.writestr("stats.json", json.dumps({"rmse": 0.1}))
        for name, text in members.items():
            archive.writestr(name, text)
    return path


@pytest.mark.parametrize("name", FILES)
def test_what_is_written_is_read_and_detected(tmp_path: Path, name: str) -> None:
    truth = curve()
    save_trajectory(tmp_path / name, truth)
    found = read_trajectory_file(tmp_path / name)
    assert found.format is TrajectoryFormat(FILES[name])
    assert np.array_equal(found.trajectory.stamps_ns, truth.stamps_ns)
    assert np.abs(found.trajectory.positions - truth.positions).max() < 1e-15
    assert np.abs((found.trajectory.quats_xyzw * truth.quats_xyzw).sum(axis=1)) == pytest.approx(1.0, abs=1e-15)


def test_kitti_poses_have_optical_axes_in_the_file(tmp_path: Path) -> None:
    ahead = Trajectory(np.array([0, 10**9]), np.array([[0.0, 0, 0], [2.0, 0.5, 0.25]]), np.tile([0.0, 0, 0, 1], (2, 1)))
    save_trajectory(tmp_path / "t.kitti", ahead)
    last = [float(word) for word in (tmp_path / "t.kitti").read_text().splitlines()[1].split()]
    assert [last[3], last[7], last[11]] == [-0.5, -0.25, 2.0], "x right, y down, z forward"
    assert (tmp_path / "t.times.txt").read_text() == "0.000000000\n1.000000000\n"


def test_stamps_of_kitti_poses(tmp_path: Path) -> None:
    truth = curve(5)
    poses = tmp_path / "poses" / "07.txt"
    poses.parent.mkdir()
    save_trajectory(poses, truth, TrajectoryFormat.KITTI)
    (tmp_path / "poses" / "07.times.txt").unlink()
    alone = read_trajectory_file(poses)
    assert alone.by_index
    assert alone.trajectory.stamps_ns.tolist() == [k * 10**9 for k in range(5)]
    times = tmp_path / "sequences" / "07" / "times.txt"
    times.parent.mkdir(parents=True)
    times.write_text("0.0\n0.1\n0.2\n0.3\n4e-1\n")
    found = read_trajectory_file(poses)
    assert found.trajectory.stamps_ns.tolist() == [k * 10**8 for k in range(5)]
    assert str(times) in found.text
    times.write_text("0.0\n")
    with pytest.raises(InputError, match="1 times for 5 poses"):
        read_trajectory_file(poses)


def test_euroc_files_of_the_data_set(tmp_path: Path) -> None:
    text = "#timestamp, p_RS_R_x [m], p_RS_R_y [m], ...\n1403636580838555648, 1.5,2,3, 0.5,-0.5,0.5,-0.5" + ",0.25" * 9
    (tmp_path / "data.csv").write_text(text + "\n")
    found = read_trajectory_file(tmp_path / "data.csv")
    assert found.format is TrajectoryFormat.EUROC
    assert found.trajectory.stamps_ns.tolist() == [1403636580838555648]
    assert found.trajectory.quats_xyzw.tolist() == [[-0.5, 0.5, -0.5, 0.5]]


def test_results_of_evo(tmp_path: Path) -> None:
    truth = curve(4)
    moved = replace(truth, positions=truth.positions + 1.0)
    members = {
        "ref.txt.tum": trajectory_text(truth, TrajectoryFormat.TUM),
        "est.txt.tum": trajectory_text(moved, TrajectoryFormat.TUM),
    }
    path = evo_zip(tmp_path / "r.zip", members)
    assert np.array_equal(read_trajectory_file(path).trajectory.positions, moved.positions)
    assert np.array_equal(read_trajectory_file(path, "truth").trajectory.positions, truth.positions)
    with pytest.raises(InputError, match="has no trajectories, only errors"):
        read_trajectory_file(evo_zip(tmp_path / "bare.zip", {}))
    with pytest.raises(InputError, match="does not say which is the estimate"):
        read_trajectory_file(evo_zip(tmp_path / "names.zip", members, est="x", ref="y"))
    (tmp_path / "torn.zip").write_bytes(path.read_bytes()[:200])
    with pytest.raises(InputError, match="cannot read"):
        read_trajectory_file(tmp_path / "torn.zip")
    with zipfile.ZipFile(tmp_path / "other.zip", "w") as archive:
        archive.writestr("a.txt", "x")
    with pytest.raises(InputError, match=r"no info\.json"):
        read_trajectory_file(tmp_path / "other.zip")


@pytest.mark.parametrize(
    ("name", "line", "message"),
    [
        ("t.kitti", "1 0 0 0 0 1 0 0 0 0 1 x", "line 3: 'x' is not a finite number"),
        ("t.kitti", "1 0 0 0 0 1 0 0 0 0 1", "line 3: 11 columns found where 12"),
        ("t.kitti", "9 0 0 0 0 1 0 0 0 0 1 0", "line 3: this is no rotation"),
        ("t.kitti", "nan 0 0 0 0 1 0 0 0 0 1 0", "line 3: 'nan' is not a finite number"),
        ("t.euroc.csv", "5.5,0,0,0,1,0,0,0", "line 4: stamp '5.5' is not whole nanoseconds"),
        ("t.euroc.csv", "5,0,0,0,1,0", "line 4: 6 columns found where 8"),
        ("t.euroc.csv", "5,0,0,0,1,1,1,1", "line 4: the quaternion .* is not a rotation"),
    ],
)
def test_wrong_lines_are_named(tmp_path: Path, name: str, line: str, message: str) -> None:
    save_trajectory(tmp_path / name, curve(5))
    lines = (tmp_path / name).read_text().splitlines()
    lines[3 if "euroc" in name else 2] = line
    (tmp_path / name).write_text("\n".join(lines))
    with pytest.raises(InputError, match=message):
        read_trajectory_file(tmp_path / name)


def test_poses_without_stamps_are_scored_pose_by_pose(tmp_path: Path, sfr: Sfr) -> None:
    truth = curve(30)
    save_trajectory(tmp_path / "truth.tum", truth)
    save_trajectory(tmp_path / "e.kitti", replace(truth, positions=truth.positions * 1.01))
    (tmp_path / "e.times.txt").unlink()
    done = sfr("score", tmp_path / "e.kitti", tmp_path / "truth.tum", "--condition", "time=1", "--json", "-")
    assert done.code == 0, done.err
    assert json.loads(done.out)["trajectory"]["matched"] == 30
    assert len(done.err.splitlines()) == 1
    assert "e.kitti: KITTI poses of the left camera" in done.err
    assert "stamps: those of" in done.err
    save_trajectory(tmp_path / "truth.tum", curve(29))
    assert "30 KITTI poses" in sfr("score", tmp_path / "e.kitti", tmp_path / "truth.tum").err


def test_members_of_a_zip_file_are_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sfr_loc_map.io.trajectory_file.MAX_TABLE_BYTES", 100)
    stream = io.StringIO("0 " * 200)
    path = evo_zip(tmp_path / "r.zip", {"est.txt.tum": stream.read()})
    with pytest.raises(InputError, match="larger than 100 bytes"):
        read_trajectory_file(path)
