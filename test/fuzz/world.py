"""Valid files of every format, small: what mutations begin with."""

from __future__ import annotations

import contextlib
import io
import json
import shutil
from pathlib import Path

import cv2
import numpy as np
from execution import run_command
from made_ros1 import write_ros1
from made_scene import LOC_RIG, NAV_RIG, PERIOD_NS, START_NS, fill, loc_pair, true_pose, write_bag, write_folder

from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.bag_writer import BagWriter
from sfr_loc_map.io.cloud_file import save_cloud
from sfr_loc_map.io.euroc import EurocWriter
from sfr_loc_map.io.kitti import KittiWriter
from sfr_loc_map.io.trajectory_file import save_trajectory
from sfr_loc_map.localisation.estimate import StartPose
from sfr_loc_map.metrics.config import AlignedErrorConfig
from sfr_loc_map.pipeline.localisation_session import PoseFile
from sfr_loc_map.pipeline.scoring import save_evo_result

REPOSITORY = Path(__file__).resolve().parents[2]
POSES = 60
KINDS = ("jpg", "pgm", "ppm", "bmp", "tiff", "webp")
"""Endings of image files, each in a drive of its own; the last two are refused."""
SCORE = ("score", "{w}/estimate.csv", "{w}/truth.csv", "--condition", "frames=5", "--spacing", "5")


def make_world(folder: Path) -> Path:
    """Write all files unless they are there, and return the folder."""
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
    for kind in KINDS:
        drive = part / f"drive-{kind}"
        shutil.copytree(part / "drive", drive)
        pairs = drive / "pairs.csv"
        pairs.write_text(pairs.read_text().replace("left/000000.png", f"left/000000.{kind}"))
        image = cv2.merge([loc_pair(0).left] * 3) if kind == "ppm" else loc_pair(0).left
        cv2.imwrite(str(drive / "left" / f"000000.{kind}"), image)
    _bags(part)
    _trajectories(part)
    _cloud(part)
    _settings(part)
    part.rename(folder)
    _made_by_commands(folder)
    return folder


def _bags(world: Path) -> None:
    write_bag(world / "bag.mcap", 2, 1)
    write_bag(world / "jpeg.mcap", 2, 0, jpeg_quality=90)
    with BagWriter(world / "bag.db3", "sqlite3") as writer:
        fill(writer, 2, 1)
    write_ros1(world / "ros1.bag", world / "bag.mcap")
    for name in ("bag.mcap", "jpeg.mcap", "bag.db3"):  # files of one name, in folders as `ros2 bag` has them
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
    named = {"est_name": "est", "ref_name": "ref"}
    save_evo_result(world / "evo.zip", estimate, truth, AlignedErrorConfig(align="none"), named)
    names = ",".join(f"cov_{i}{j}" for i in range(6) for j in range(i, 6))
    covariance = ",".join(f"{0.0001 if i == j else 0.0:g}" for i in range(6) for j in range(i, 6))
    rows = [f"stamp_ns,processing_time_s,state,peak_rss_bytes,above_idle_bytes,align_s,{names}"]
    rows += [f"{stamp},0.0{i % 9 + 1},tracking,{10**8 + i},9,0.001,{covariance}" for i, (stamp, _) in enumerate(poses)]
    (world / "stats.csv").write_text("\n".join(rows) + "\n")


def _cloud(world: Path) -> None:
    truth = np.load(next((world / "panorama").rglob("*.npy")))
    v, u = (grid[::4, ::4].reshape(-1) for grid in np.mgrid[: NAV_RIG.height, : NAV_RIG.width])
    records = np.zeros(len(u), PointCloud.dtype())
    for axis, name in enumerate("xyz"):
        records[name] = truth[v, u, axis]
    records["sigma"], records["intensity"], records["u"], records["v"] = 0.01, 100, u, v
    for suffix in ("ply", "pcd", "npz"):
        save_cloud(world / f"cloud.{suffix}", PointCloud.from_structured(records, False))
    text = (" ".join(map(str, record)) for record in records[:50].tolist())
    head = (world / "cloud.pcd").read_bytes().split(b"DATA")[0].decode().replace(str(len(u)), "50")
    (world / "text.pcd").write_text(head + "DATA ascii\n" + "\n".join(text) + "\n")


def _settings(world: Path) -> None:
    for name in ("localisation.yaml", "mapping.yaml", "limits_example.yaml"):
        shutil.copy(REPOSITORY / "config" / name, world / name)
    limits = (world / "limits_example.yaml").read_text().replace("distance=5", "frames=5")
    (world / "limits_example.yaml").write_text(limits)
    shutil.copy(REPOSITORY / "config" / "simulation" / "low_sun.yaml", world / "scenario.yaml")
    (world / "arguments.json").write_text(json.dumps(["name.csv", "distance=5", "/a:=/b"]))
    PoseFile(world / "resume.json", 1.0).save(
        StartPose(Transform.identity(), np.eye(6), 1_700_000_000_000_000_000), LOC_RIG
    )


def _made_by_commands(world: Path) -> None:
    limits = ("--limits", "{w}/limits_example.yaml", "--stats", "{w}/stats.csv")
    for name, extra in (("score.json", limits), ("score2.json", ())):
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()) as errors:
            run_command((*SCORE, *extra, "--json", f"{{w}}/{name}"), world, world)
        if not (world / name).exists():
            raise SystemExit(f"no score could be made: {errors.getvalue()}")
    with contextlib.suppress(ImportError):
        from message_targets import make_messages

        make_messages(world)
