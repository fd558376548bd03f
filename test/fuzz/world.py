"""Valid files of every format, small: what mutations begin with."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import scene_path  # noqa: F401 - before the next
from made_ros1 import write_ros1
from made_rovers import write_katwijk, write_lusnar, write_madmax
from made_scene import (
    LOC_RIG,
    NAV_RIG,
    PERIOD_NS,
    START_NS,
    T_RB_LOCSB,
    fill,
    image,
    loc_pair,
    true_pose,
    write_bag,
    write_folder,
)

from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.bag_writer import BagWriter
from sfr_loc_map.io.cloud_file import save_cloud
from sfr_loc_map.io.image_codec import encode_png
from sfr_loc_map.io.trajectory_file import save_trajectory
from sfr_loc_map.metrics.config import AlignedErrorConfig
from sfr_loc_map.pipeline.scoring import save_evo_result

__all__ = ["KINDS", "LOC_RIG", "T_RB_LOCSB", "encoded_image", "loc_pair", "make_world"]
REPOSITORY = Path(__file__).resolve().parents[2]
POSES = 60
KINDS = ("jpg", "pgm", "ppm", "bmp", "tiff", "webp", "hdr", "exr", "jp2", "ras", "gif", "pfm")
"""Endings of image files, each in a drive of its own."""


def make_world(folder: Path) -> None:
    """Write all files; a world that is there already is left as it is."""
    if folder.exists():
        return
    part = folder.with_name(folder.name + ".part")
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir(parents=True)
    write_folder(part / "drive", 2, 0)
    write_folder(part / "panorama", 0, 1)
    _bags(part)
    _trajectories(part)
    _cloud(part)
    _kitti(part / "kitti")
    _euroc(part / "euroc")
    for kind in KINDS:
        _image_drive(part, kind)
    write_madmax(part / "A-0")
    write_katwijk(part / "Part1")
    write_lusnar(part / "Moon_1")
    write_ros1(part / "ros1.bag", part / "bag.mcap")
    _texts(part)
    part.rename(folder)


def _bags(world: Path) -> None:
    write_bag(world / "bag.mcap", 2, 1)
    write_bag(world / "jpeg.mcap", 2, 0, jpeg_quality=90)
    with BagWriter(world / "bag.db3", "sqlite3") as writer:
        fill(writer, 2, 1)
    for name in ("bag.mcap", "jpeg.mcap", "bag.db3"):  # files of one name, in folders as `ros2 bag` has them
        file = next((world / name).glob(f"*{Path(name).suffix}"))
        file.rename(file.with_name(f"bag{file.suffix}"))
        metadata = world / name / "metadata.yaml"
        metadata.write_text(metadata.read_text().replace(file.name, f"bag{file.suffix}"))


def _trajectories(world: Path) -> None:
    poses = [(START_NS + i * PERIOD_NS, true_pose(i)) for i in range(POSES)]
    save_trajectory(world / "truth.csv", Trajectory.from_poses(iter(poses)))
    rng = np.random.default_rng(1)
    shifted = [(stamp, Transform(pose.rotation, pose.translation + rng.normal(0, 0.01, 3))) for stamp, pose in poses]
    estimate = Trajectory.from_poses(iter(shifted))
    for name in ("estimate.csv", "estimate.tum", "estimate.kitti", "estimate.euroc.csv"):
        save_trajectory(world / name, estimate)
    truth, named = Trajectory.from_poses(iter(poses)), {"est_name": "est", "ref_name": "ref"}
    save_evo_result(world / "evo.zip", estimate, truth, AlignedErrorConfig(align="none"), named)
    names = ",".join(f"cov_{i}{j}" for i in range(6) for j in range(i, 6))
    covariance = ",".join(f"{0.0001 if i == j else 0.0:g}" for i in range(6) for j in range(i, 6))
    rows = [f"stamp_ns,processing_time_s,state,peak_rss_bytes,above_idle_bytes,align_s,{names}"]
    rows += [
        f"{stamp},0.0{i % 9 + 1},tracking,{10**8 + i},{10**7},0.001,{covariance}" for i, (stamp, _) in enumerate(poses)
    ]
    (world / "stats.csv").write_text("\n".join(rows) + "\n")


def _cloud(world: Path) -> None:
    truth = np.load(next((world / "panorama").rglob("*.npy")))
    v, u = (grid[::4, ::4].reshape(-1) for grid in np.mgrid[: NAV_RIG.height, : NAV_RIG.width])
    records = np.zeros(len(u), PointCloud.dtype())
    for axis, name in enumerate("xyz"):
        records[name] = truth[v, u, axis]
    records["sigma"], records["intensity"], records["u"], records["v"] = 0.01, 100, u, v
    for suffix in ("ply", "pcd", "npz", "las", "laz"):
        save_cloud(world / f"cloud.{suffix}", PointCloud.from_structured(records, False))
    text = (f"{x} {y} {z} {s} {i} {a} {b} {p}" for x, y, z, s, i, a, b, p in records[:50].tolist())
    head = (world / "cloud.pcd").read_bytes().split(b"DATA")[0].decode().replace(str(len(u)), "50")
    (world / "text.pcd").write_text(head + "DATA ascii\n" + "\n".join(text) + "\n")


def _images(rig: StereoRig, index: int) -> tuple[np.ndarray, np.ndarray]:
    left = true_pose(index) @ T_RB_LOCSB @ rig.T_sb_left
    right = left @ Transform(np.eye(3), np.array([rig.baseline_m, 0.0, 0.0]))
    return image(left, rig), image(right, rig)


def _kitti(folder: Path) -> None:
    for number, name in enumerate(("image_0", "image_1")):
        (folder / name).mkdir(parents=True)
        for index in range(2):
            (folder / name / f"{index:06d}.png").write_bytes(encode_png(_images(LOC_RIG, index)[number]))
    rig = LOC_RIG
    shifts = (0.0, -rig.fx * rig.baseline_m)
    lines = [f"P{i}: {rig.fx} 0 {rig.cx} {s} 0 {rig.fy} {rig.cy} 0 0 0 1 0" for i, s in enumerate(shifts)]
    (folder / "calib.txt").write_text("\n".join(lines) + "\n")
    (folder / "times.txt").write_text("0.000000e+00\n1.000000e-01\n")
    (folder / "poses.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0.02 0 1 0 0 0 0 1 0.05\n")


def _euroc(folder: Path) -> None:
    for number, name in enumerate(("cam0", "cam1")):
        camera = folder / "mav0" / name
        (camera / "data").mkdir(parents=True)
        rows = ["#timestamp [ns],filename"]
        for index in range(2):
            stamp = START_NS + index * PERIOD_NS
            (camera / "data" / f"{stamp}.png").write_bytes(encode_png(_images(LOC_RIG, index)[number]))
            rows.append(f"{stamp},{stamp}.png")
        (camera / "data.csv").write_text("\n".join(rows) + "\n")
        (camera / "sensor.yaml").write_text(
            "%YAML:1.0\nsensor_type: camera\nT_BS:\n  cols: 4\n  rows: 4\n"
            f"  data: [0.0, 0.0, 1.0, 0.0, -1.0, 0.0, 0.0, {0.06 - 0.12 * number}, "
            "0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]\n"
            "rate_hz: 10\nresolution: [160, 120]\ncamera_model: pinhole\nintrinsics: [150.0, 150.0, 79.5, 59.5]\n"
            "distortion_model: radial-tangential\ndistortion_coefficients: [0.01, 0.0, 0.0, 0.0]\n"
        )
    truth = folder / "mav0" / "state_groundtruth_estimate0"
    truth.mkdir()
    rows = [f"{START_NS + i * PERIOD_NS},{0.02 * i},0,0,1,0,0,0,0,0,0" for i in range(2)]
    (truth / "data.csv").write_text("\n".join(["#timestamp, p, q", *rows]) + "\n")


def encoded_image(kind: str) -> bytes:
    """Return an image in a format, or bytes that begin like it where this OpenCV does not write it."""
    left = _images(LOC_RIG, 0)[0]
    written: np.ndarray = left
    if kind in ("hdr", "pfm", "ppm", "gif"):
        written = cv2.cvtColor(left, cv2.COLOR_GRAY2BGR)
    if kind in ("hdr", "pfm"):
        written = written.astype(np.float32) / 255
    try:
        good, data = cv2.imencode(f".{kind}", written)
        if good:
            return bytes(data)
    except cv2.error:
        pass
    magic = {"exr": b"v/1\x01\x02\0\0\0", "gif": b"GIF89a", "jp2": b"\0\0\0\x0cjP  \r\n\x87\n"}.get(kind, b"")
    return magic + bytes(np.random.default_rng(3).integers(0, 256, 2000, dtype=np.uint8))


def _image_drive(world: Path, kind: str) -> None:
    folder = world / f"drive-{kind}"
    shutil.copytree(world / "drive", folder)
    pairs = folder / "pairs.csv"
    pairs.write_text(pairs.read_text().replace("left/000000.png", f"left/000000.{kind}"))
    (folder / "left" / f"000000.{kind}").write_bytes(encoded_image(kind))


def _texts(world: Path) -> None:
    for name in ("localisation.yaml", "mapping.yaml", "limits_example.yaml"):
        shutil.copy(REPOSITORY / "config" / name, world / name)
    limits = (world / "limits_example.yaml").read_text().replace("distance=5", "frames=5")
    (world / "limits_example.yaml").write_text(limits)
    shutil.copy(REPOSITORY / "config" / "simulation" / "low_sun.yaml", world / "scenario.yaml")
