"""A rover that drives in front of a textured wall: small images with exact ground truth."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from rosbags.rosbag2 import Reader, Writer

from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.bag.encoding import TYPESTORE
from sfr_loc_map.io.bag.writer import BagWriter
from sfr_loc_map.io.layouts.folder import FolderWriter

WIDTH, HEIGHT = 160, 120
WALL_X_M = 3.0
START_NS = 1_700_000_000_123_456_789
PERIOD_NS = 100_000_000
T_RB_LOCSB = Transform.from_quat([0.3, 0.01, 0.2], [0.01, -0.02, 0.03, 0.9993])
LOC_RIG = StereoRig(WIDTH, HEIGHT, 150.0, 150.0, 79.5, 59.5, 0.12, T_RB_LOCSB)
NAV_RIG = StereoRig(WIDTH, HEIGHT, 150.0, 150.0, 79.5, 59.5, 0.12)


def forged(rig: StereoRig, **changes: float) -> StereoRig:
    """Return a rig with values that it would refuse, to make messages of."""
    made = replace(rig)
    for name, value in changes.items():
        object.__setattr__(made, name, value)
    return made


def _texture() -> np.ndarray:
    noise = np.random.default_rng(5).normal(size=(900, 900)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 2.2) + 0.5 * cv2.GaussianBlur(noise, (0, 0), 5.0)
    return np.clip(128 + 45 * smooth / smooth.std(), 0, 255).astype(np.float32)


TEXTURE = _texture()


def wall_points(T_world_left: Transform, rig: StereoRig) -> np.ndarray:
    """Return the point of the wall x = WALL_X_M at each pixel, `(H, W, 3)` float64."""
    u, v = np.meshgrid(np.arange(rig.width), np.arange(rig.height))
    rays = np.stack(((u - rig.cx) / rig.fx, (v - rig.cy) / rig.fy, np.ones(u.shape)), axis=-1) @ T_world_left.rotation.T
    origin = T_world_left.translation
    return origin + rays * ((WALL_X_M - origin[0]) / rays[..., 0])[..., None]


def image(T_world_left: Transform, rig: StereoRig) -> np.ndarray:
    points = wall_points(T_world_left, rig)
    at = (points[..., 1:] * rig.fx + 450).astype(np.float32)
    pixels = cv2.remap(TEXTURE, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    return np.rint(pixels).astype(np.uint8)


def stereo_pair(stamp_ns: int, T_world_sb: Transform, rig: StereoRig) -> StereoPair:
    left = T_world_sb @ rig.T_sb_left
    right = left @ Transform(np.eye(3), np.array([rig.baseline_m, 0.0, 0.0]))
    return StereoPair(stamp_ns, image(left, rig), image(right, rig))


def true_pose(index: int) -> Transform:
    """Return `T_ds_rb` of a pair: forward and sideways with a slight turn."""
    rotation = matrix_from_rotvec([0.0, 0.0, 0.1 + 0.004 * index])
    return Transform(rotation, np.array([0.02 * index, -0.4 + 0.015 * index, 0.05]))


def loc_pair(index: int) -> StereoPair:
    return stereo_pair(START_NS + index * PERIOD_NS, true_pose(index) @ T_RB_LOCSB, LOC_RIG)


def nav_pair(index: int) -> PosedStereoPair:
    rotation = matrix_from_rotvec([0.0, 0.02, 0.05 * (index - 1)])
    T_lm_navsb = Transform.from_quat([0.2, 0.1 * index, 0.3], Transform(rotation, np.zeros(3)).quat_xyzw)
    pair = stereo_pair(START_NS + index * PERIOD_NS, T_lm_navsb, NAV_RIG)
    truth = wall_points(T_lm_navsb @ NAV_RIG.T_sb_left, NAV_RIG).astype(np.float32)
    return PosedStereoPair(pair, T_lm_navsb, truth)


def true_cloud(number: int = 0) -> PointCloud:
    """Return a point at the true place of each pixel of a mapping pair, with a sigma of 50 mm."""
    truth = nav_pair(number).truth
    assert truth is not None
    v, u = (part.ravel().astype(np.uint16) for part in np.indices(truth.shape[:2]))
    same = np.full(len(u), 0.05, np.float32)
    return PointCloud(truth.reshape(-1, 3), same, same, u, v, np.full(len(u), number, np.uint8), fused=False)


def fill(writer: FolderWriter | BagWriter, loc_pairs: int, nav_pairs: int) -> None:
    if loc_pairs:
        writer.write_loc_rig(LOC_RIG)
    if nav_pairs:
        writer.write_nav_rig(NAV_RIG)
    for index in range(loc_pairs):
        pose = true_pose(index)
        writer.write_truth(START_NS + index * PERIOD_NS, pose.translation, pose.quat_xyzw)
        writer.write_loc_pair(loc_pair(index))
    for index in range(nav_pairs):
        writer.write_nav_pair(nav_pair(index))


def write_folder(path: Path, loc_pairs: int, nav_pairs: int) -> Path:
    with FolderWriter(path, loc=loc_pairs > 0, nav=nav_pairs > 0) as writer:
        fill(writer, loc_pairs, nav_pairs)
    return path


def write_bag(path: Path, loc_pairs: int, nav_pairs: int, jpeg_quality: int | None = None) -> Path:
    with BagWriter(path, jpeg_quality=jpeg_quality) as writer:
        fill(writer, loc_pairs, nav_pairs)
    return path


def compressed_bag(folder: Path, pairs: int) -> Path:
    """Return a bag of a driver's compressed images, named `image_raw/compressed`, with camera_info and a truth."""
    bag, ours = folder / "cam", write_bag(folder / "ours.mcap", pairs, 0, jpeg_quality=95)
    with Reader(ours) as reader, Writer(bag, version=9) as writer:
        names = {
            c.id: c.topic.replace("/loc/", "/front/").replace("image_rect", "image_raw") for c in reader.connections
        }
        kinds = {c.id: c.msgtype for c in reader.connections}
        added = {each: writer.add_connection(names[each], kinds[each], typestore=TYPESTORE) for each in names}
        for connection, recorded_ns, data in reader.messages():
            writer.write(added[connection.id], recorded_ns, data)
    return bag
