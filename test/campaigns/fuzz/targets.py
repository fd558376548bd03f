"""Targets of the fuzzer: small valid files of every format, their mutations, and the commands or readers."""

from __future__ import annotations

import contextlib
import io
import shutil
from pathlib import Path

import cv2
import numpy as np

from campaigns.fuzz import mutations as m
from campaigns.fuzz.inputs import Command, Target, run_command
from helpers.made_ros1 import write_ros1
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.bag.writer import BagWriter
from sfr_loc_map.io.clouds.cloud_file import save_cloud
from sfr_loc_map.io.layouts.euroc import EurocWriter
from sfr_loc_map.io.layouts.kitti import KittiWriter
from sfr_loc_map.io.tables.trajectory_writer import save_trajectory

from helpers.made_scene import NAV_RIG, PERIOD_NS, START_NS, fill, loc_pair, true_pose, write_bag, write_folder  # isort: skip

CONFIG = Path(__file__).resolve().parents[3] / "config"
POSES = 60
SCORE = ("score", "{w}/estimate.csv", "{w}/truth.csv", "--condition", "frames=5", "--spacing", "5")


def make_world(folder: Path) -> Path:
    """Write all files unless the folder exists, and return the folder."""
    if folder.exists():
        return folder
    part = folder.with_name(folder.name + ".part")
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir(parents=True)
    write_folder(part / "drive", 2, 0)
    write_folder(part / "panorama", 0, 1)
    for path, writer in ((part / "kitti", KittiWriter), (part / "euroc", EurocWriter)):
        with writer(path) as opened:
            fill(opened, 2, 0)
    sensor = part / "euroc/mav0/cam0/sensor.yaml"
    sensor.write_text(sensor.read_text().replace("coefficients: [0.0,", "coefficients: [0.01,"))
    for kind in ("jpg", "pgm"):
        drive = part / f"drive-{kind}"
        shutil.copytree(part / "drive", drive)
        pairs = drive / "pairs.csv"
        pairs.write_text(pairs.read_text().replace("left/000000.png", f"left/000000.{kind}"))
        cv2.imwrite(str(drive / "left" / f"000000.{kind}"), loc_pair(0).left)
    _bags(part)
    _trajectories(part)
    _write_cloud(part)
    for new, name in (("l", "localisation"), ("m", "mapping"), ("scenario", "simulation/low_sun")):
        shutil.copy(CONFIG / f"{name}.yaml", part / f"{new}.yaml")
    limits = (CONFIG / "limits_example.yaml").read_text().replace("distance=5", "frames=5")
    (part / "limits.yaml").write_text(limits)
    for name in ("score.json", "score2.json"):
        options = ("--limits", "{w}/limits.yaml", "--stats", "{w}/stats.csv", "--json", f"{{w}}/{name}")
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()) as errors:
            run_command((*SCORE, *options), part, part)
        if not (part / name).exists():
            raise SystemExit(f"no score could be made: {errors.getvalue()}")
    part.rename(folder)
    return folder


def _bags(world: Path) -> None:
    write_bag(world / "bag.mcap", 2, 1)
    with BagWriter(world / "bag.db3", "sqlite3") as writer:
        fill(writer, 2, 1)
    write_ros1(world / "ros1.bag", world / "bag.mcap")
    for name in ("bag.mcap", "bag.db3"):  # fixed file names, in folders like those of `ros2 bag`
        file = next((world / name).glob(f"*{Path(name).suffix}"))
        file.rename(file.with_name(f"bag{file.suffix}"))
        metadata = world / name / "metadata.yaml"
        metadata.write_text(metadata.read_text().replace(file.name, f"bag{file.suffix}"))


def _trajectories(world: Path) -> None:
    poses = [(START_NS + i * PERIOD_NS, true_pose(i)) for i in range(POSES)]
    truth = Trajectory.from_poses(poses)
    rng = np.random.default_rng(1)
    shifted = ((stamp, Transform(pose.rotation, pose.translation + rng.normal(0, 0.01, 3))) for stamp, pose in poses)
    estimate = Trajectory.from_poses(shifted)
    save_trajectory(world / "truth.csv", truth)
    for name in ("estimate.csv", "estimate.tum", "estimate.kitti", "estimate.euroc.csv"):
        save_trajectory(world / name, estimate)
    rows = ["stamp_ns,processing_time_s,state,peak_rss_bytes,above_idle_bytes,align_s"]
    rows += [f"{stamp},0.0{i % 9 + 1},tracking,{10**8 + i},9,0.001" for i, (stamp, _) in enumerate(poses)]
    (world / "stats.csv").write_text("\n".join(rows) + "\n")


def _write_cloud(world: Path) -> None:
    truth = np.load(next((world / "panorama").rglob("*.npy")))
    v, u = (grid[::4, ::4].reshape(-1) for grid in np.mgrid[: NAV_RIG.height, : NAV_RIG.width])
    records = np.zeros(len(u), PointCloud.dtype())
    for axis, name in enumerate("xyz"):
        records[name] = truth[v, u, axis]
    records["sigma"], records["intensity"], records["u"], records["v"] = 0.01, 100, u, v
    for suffix in ("ply", "pcd", "npz"):
        save_cloud(world / f"cloud.{suffix}", PointCloud.from_structured(records, False))


def _localise(source: str, *options: str) -> Command:
    return ("localise", f"{{w}}/{source}", "-o", "{o}/t.csv", "--stats", "{o}/s.csv", "--start", "truth", *options)


def _map(source: str, *options: str) -> Command:
    return ("map", f"{{w}}/{source}", "-o", "{o}/c.ply", *options)


def _convert(source: str, *targets: str) -> list[Command]:
    return [("convert", f"{{w}}/{source}", f"{{o}}/{target}") for target in targets]


def _drive(source: str, *targets: str) -> tuple[Command, ...]:
    """Return the commands that localise a drive and convert it to files."""
    return (_localise(source), *_convert(source, *targets))


def _bag(name: str) -> tuple[Command, ...]:
    bag = f"{name}/bag{Path(name).suffix}"
    return (
        *(*_drive(name, "t.csv"), *_drive(bag, "folder", "b.db3"), _map(bag), ("info", f"{{w}}/{name}")),
        ("score", "{w}/estimate.csv", f"{{w}}/{name}"),
        ("simulate", "{o}/p", "--from", f"{{w}}/{bag}", "--fault", "noisy"),
    )


def _cloud(name: str, *targets: str) -> tuple[Command, ...]:
    return (("score", f"{{w}}/{name}", "{w}/panorama"), *_convert(name, *targets))


def _trajectory(name: str) -> tuple[Command, ...]:
    place = f"{{w}}/{name}"
    scores = (("score", place, "{w}/truth.csv", *SCORE[3:]), ("score", "{w}/truth.csv", place, *SCORE[3:]))
    return (*scores, ("score", place, "{w}/truth.csv", "--diagnose"), *_convert(name, "t.tum", "t.mcap"))


def plan_simulation(path: Path) -> None:
    """Read a scenario like `sfr simulate`, without rendering."""
    from sfr_loc_map.configuration.parameters import build
    from sfr_loc_map.configuration.yaml_file import load_yaml
    from sfr_loc_map.simulation.config import SimulationConfig
    from sfr_loc_map.simulation.plan import Plan

    Plan.make(build(SimulationConfig, load_yaml(path), origin=str(path)))


T = m.TEXT + m.BYTES
_PANORAMA = (_map("panorama"), *_convert("panorama", "b.mcap", "f"))
_EUROC, _TRUTH = "euroc/mav0", "state_groundtruth_estimate0/data.csv"
_SCORES = (
    *(("report", "{w}/score.json", "-o", f"{{o}}/x.{kind}") for kind in ("html", "md", "csv")),
    *(("report", "{w}/score.json", "{w}/score2.json", "-o", "{o}/x.html"),),
)
TARGETS = (
    Target("rig.json", "drive/rig.json", m.JSON, _drive("drive", "f", "b.mcap")),
    Target("pairs.csv", "drive/pairs.csv", T, _drive("drive", "b.mcap")),
    Target("pairs.csv of mapping", "panorama/pairs.csv", T, _PANORAMA),
    Target("groundtruth.csv", "drive/groundtruth.csv", T, (*_drive("drive", "t.csv"), (*SCORE[:2], "{w}/drive"))),
    Target("trajectory csv", "estimate.csv", T, _trajectory("estimate.csv")),
    Target("TUM", "estimate.tum", T, _trajectory("estimate.tum")),
    Target("KITTI poses", "estimate.kitti", T, _trajectory("estimate.kitti")),
    Target("KITTI stamps", "estimate.times.txt", T, _trajectory("estimate.kitti")),
    Target("EuRoC poses", "estimate.euroc.csv", T, _trajectory("estimate.euroc.csv")),
    Target("KITTI calib.txt", "kitti/calib.txt", T, _drive("kitti", "b.mcap")),
    Target("KITTI times.txt", "kitti/times.txt", T, _drive("kitti", "f")),
    Target("KITTI poses.txt", "kitti/poses.txt", T, _drive("kitti", "t.csv")),
    Target("EuRoC sensor.yaml", f"{_EUROC}/cam0/sensor.yaml", T + m.YAML[-2:], _drive("euroc")),
    Target("EuRoC data.csv", f"{_EUROC}/cam1/data.csv", T, _drive("euroc", "f")),
    Target("EuRoC truth", f"{_EUROC}/{_TRUTH}", T, _drive("euroc", "t.tum")),
    Target("PNG", "drive/left/000000.png", m.PNG, _drive("drive", "b.mcap")),
    Target("JPEG", "drive-jpg/left/000000.jpg", m.BYTES, _drive("drive-jpg", "b.mcap")),
    Target("PGM", "drive-pgm/left/000000.pgm", m.HEADED, _drive("drive-pgm", "b.mcap")),
    Target("truth .npy", "panorama/truth/000000.npy", m.HEADED, (*_PANORAMA, *_cloud("cloud.ply"))),
    Target("NPZ", "cloud.npz", m.ZIP, _cloud("cloud.npz", "x.ply")),
    Target("PLY", "cloud.ply", m.HEADED, _cloud("cloud.ply")),
    Target("PCD", "cloud.pcd", m.HEADED, _cloud("cloud.pcd")),
    Target("mcap", "bag.mcap/bag.mcap", m.MCAP, _bag("bag.mcap")),
    Target("ROS 1 bag", "ros1.bag", m.BYTES, (*_drive("ros1.bag", "f"), ("info", "{w}/ros1.bag"), _map("ros1.bag"))),
    Target("sqlite3", "bag.db3/bag.db3", m.SQLITE, _bag("bag.db3")),
    Target("metadata.yaml", "bag.mcap/metadata.yaml", m.YAML, _bag("bag.mcap")),
    Target("localisation config", "l.yaml", m.YAML, (_localise("drive", "--config", "{w}/l.yaml"),)),
    Target("mapping config", "m.yaml", m.YAML, (_map("panorama", "--config", "{w}/m.yaml"),)),
    Target("limits", "limits.yaml", m.YAML, ((*SCORE, "--limits", "{w}/limits.yaml"),)),
    Target("stats csv", "stats.csv", T, ((*SCORE, "--stats", "{w}/stats.csv"),)),
    Target("target timing", "stats.csv", T, ((*SCORE, "--target", "LEON", "--target-timing", "{w}/stats.csv"),)),
    Target("score JSON", "score.json", m.JSON, _SCORES),
    Target("scenario", "scenario.yaml", m.YAML, (plan_simulation,)),
)


def all_targets() -> dict[str, Target]:
    """Return all targets by name."""
    return {target.name: target for target in TARGETS}
