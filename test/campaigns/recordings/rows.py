"""The recordings, one function each: the same drive as recorded by various drivers, tools and laboratories."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

import cv2
import numpy as np
import yaml
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.storage_mcap import McapWriter, Schema
from rosbags.typesys import Stores, get_typestore

from campaigns.recordings.bags import (
    ENCODE,
    OPTICAL,
    STORE,
    Recording,
    T,
    add_pair,
    add_static,
    camera_info,
    header,
    nav_sat_fix,
    odometry,
    pose,
    transform,
    vector,
    with_covariance,
)
from campaigns.recordings.drive import ANTENNA_M, BEGIN_NS, MARKERS_XYZW, Drive
from sfr_loc_map.geometry.extrinsics import mast_head_in_rb
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.calibration.rig_file import rig_json as rig_text
from sfr_loc_map.simulation.config import NavCamerasConfig, PanoramaConfig
from sfr_loc_map.simulation.rover import rig_extrinsics

TRUTH = "/ground_truth/odom"


@dataclass(frozen=True)
class Made:
    """A recording: its path, and the settings that only its owner knows."""

    source: Path
    calibration: Path | None = None
    settings: dict[str, Any] = field(default_factory=dict)  #: Settings by their names in `sfr.yaml`.


Make = Callable[[Path, Drive], Made]


@dataclass(frozen=True)
class Row:
    """A kind of recording: the function that makes it, and the allowed deviation of its error from the plain one."""

    name: str
    make: Make
    loses: float  #: Allowed deviation of mean + 3 sigma over 1 m, mm, or of a map's 95th percentile, m.
    why: str
    figure: str = "position"  #: Compared figure: `position`, `chord` (truth without attitude) or `map`.


ROWS: dict[str, Row] = {}


def row(loses: float, why: str, figure: str = "position") -> Callable[..., Make]:
    def register(make: Make, name: str = "") -> Make:
        ROWS[name or make.__name__] = Row(name or make.__name__, make, loses, why, figure)
        return make

    return register


def add_truth(recording: Recording, drive: Drive, topic: str = TRUTH) -> None:
    for stamp_ns, T_ds_rb in drive.truth():
        recording.add(topic, stamp_ns, odometry(header(stamp_ns, "map"), "base_link", T_ds_rb))


def camera_of(
    drive: Drive,
    left: str,
    right: str,
    frames: tuple[str, str],
    links: Sequence[str],
    info: str = "camera_info",
    truth: bool = True,
    **more: Any,
) -> Recording:
    """Return the recording of a driver: image topics, frames of the images, /tf_static from the base to the left."""
    recording = Recording()
    infos = tuple(f"{topic.removesuffix('/compressed').rpartition('/')[0]}/{info}" for topic in (left, right))
    add_pair(recording, drive, (left, right), more.pop("infos", infos), frames, **more)
    add_static(recording, drive, [*links, frames[0]], frames[1])
    if truth:
        add_truth(recording, drive)
    return recording


STEREO = ("/stereo/left/image_rect", "/stereo/right/image_rect", ("left_optical", "right_optical"))
STEREO_LINKS = ("base_link", "stereo_link", "left_link")


def stereo(drive: Drive, ending: str = "", **more: Any) -> Recording:
    """Return a recording of a rectified pair with common names."""
    left, right, frames = STEREO
    return camera_of(drive, left + ending, right + ending, frames, STEREO_LINKS, **more)


# ---- cameras


@row(0.0, "the names of the suite itself: what all others are compared to")
def plain(folder: Path, drive: Drive) -> Made:
    recording = Recording()
    names = [f"/loc/{side}/" for side in ("left", "right")]
    images, infos = (tuple(name + what for name in names) for what in ("image_rect", "camera_info"))
    add_pair(recording, drive, images, infos, ("loc_left_optical", "loc_right_optical"))
    rb_locsb, left = drive.rig.T_rb_sb, drive.rig.T_sb_left
    assert rb_locsb is not None
    edges = [transform(BEGIN_NS, *e) for e in (("rb", "locsb", rb_locsb), ("locsb", "loc_left_optical", left))]
    recording.add("/tf_static", BEGIN_NS, T["tf2_msgs/msg/TFMessage"](edges))
    for stamp_ns, T_ds_rb in drive.truth():
        recording.add("/ground_truth/odometry", stamp_ns, odometry(header(stamp_ns, "ds"), "rb", T_ds_rb))
    return Made(add_mapping(recording, drive, "/nav", "pose").write(folder / "bag"))


@row(0.01, "bgra8 of a grey image is that image")
def zed(folder: Path, drive: Drive) -> Made:
    root, frame = "/zed/zed_node", "zed_{}_camera_frame_optical"
    links = ("base_link", "zed_camera_link", "zed_camera_center", "zed_left_camera_frame")
    names = [f"{root}/{side}/color/rect/image" for side in ("left", "right")]
    recording = camera_of(drive, *names, (frame.format("left"), frame.format("right")), links, encoding="bgra8")
    for stamp_ns, T_ds_rb in drive.truth():  # the camera's own odometry is not a ground truth
        drifted = Transform(T_ds_rb.rotation, 1.05 * T_ds_rb.translation)
        recording.add(f"{root}/odom", stamp_ns, odometry(header(stamp_ns, "odom"), "zed_camera_link", drifted))
        recording.add(
            f"{root}/pose", stamp_ns, T["geometry_msgs/msg/PoseStamped"](header(stamp_ns, "map"), pose(drifted))
        )
    return Made(recording.write(folder / "zed"), settings={"truth.source": TRUTH})


@row(0.01, "bgra8 of a grey image is that image")
def zed_before_5(folder: Path, drive: Drive) -> Made:
    names = [f"/zed2i/zed_node/{side}/image_rect_color" for side in ("left", "right")]
    frames = ("zed2i_left_camera_optical_frame", "zed2i_right_camera_optical_frame")
    links = ("base_link", "zed2i_base_link", "zed2i_camera_center", "zed2i_left_camera_frame")
    return Made(camera_of(drive, *names, frames, links, encoding="bgra8").write(folder / "zed2i"))


def realsense(drive: Drive, **more: Any) -> Recording:
    names = [f"/camera/camera/infra{k}/image_rect_raw" for k in (1, 2)]
    frames = ("camera_infra1_optical_frame", "camera_infra2_optical_frame")
    links = ("base_link", "camera_bottom_screw_frame", "camera_link", "camera_infra1_frame")
    recording = camera_of(drive, *names, frames, links, **more)
    for stamp_ns, (left, _) in zip(drive.stamps_ns, drive.images, strict=True):
        for what, encoding in (("color/image_raw", "rgb8"), ("depth/image_rect_raw", "mono16")):
            head = header(stamp_ns, f"camera_{what[:5]}_optical_frame")
            recording.add(f"/camera/camera/{what}", stamp_ns, ENCODE[encoding](left[::4, ::4].copy(), head))
        recording.add("/camera/camera/color/camera_info", stamp_ns, camera_info(drive, head, 0.0))
    return recording


@row(0.01, "the same grey images")
def realsense_infra(folder: Path, drive: Drive) -> Made:
    return Made(realsense(drive).write(folder / "d435i"))


@row(0.01, "the baseline is in /tf_static")
def realsense_without_p3(folder: Path, drive: Drive) -> Made:
    return Made(realsense(drive, right_p3=0.0).write(folder / "d435"))


@row(0.01, "the same grey images")
def oak_d(folder: Path, drive: Drive) -> Made:
    names = [f"/oak/{side}/image_rect" for side in ("left", "right")]
    frames = ("oak_left_camera_optical_frame", "oak_right_camera_optical_frame")
    links = ("base_link", "oak-d-base-frame", "oak_model_origin", "oak_left_camera_frame")
    recording = camera_of(drive, *names, frames, links)
    for stamp_ns, (left, _) in zip(drive.stamps_ns, drive.images, strict=True):
        head = header(stamp_ns, frames[1])
        recording.add("/oak/stereo/image_raw", stamp_ns, ENCODE["mono16"](left[::4, ::4].copy(), head))
        recording.add("/oak/stereo/camera_info", stamp_ns, camera_info(drive, head, 0.0))
    return Made(recording.write(folder / "oak"))


@row(0.6, "raw images without distortion are rectified by maps of 1/32 pixel")
def usb_cams(folder: Path, drive: Drive) -> Made:
    names, frames = ("/camera_left/image_raw", "/camera_right/image_raw"), ("camera_left", "camera_right")
    links = ("base_link", "bumper", "camera_left_body")
    return Made(camera_of(drive, *names, frames, links, encoding="yuyv").write(folder / "usb"))


ENCODED = {
    "compressed_jpeg": ("jpeg", 1.5, "JPEG of quality 90 on top of that of the sample"),
    "compressed_png": ("png", 0.01, "PNG loses nothing"),
    "grey_16_bit": ("mono16", 0.01, "16 bits that are 257 times 8 bits"),
    "grey_12_bit": (
        "mono12",
        0.5,
        "16 times 8 bits: the depth is found, rounding changes half of the pixels by a grey level",
    ),
    "grey_10_bit": ("mono10", 0.1, "4 times 8 bits: the depth is found, rounding changes one pixel of a hundred"),
    "luma_plane": ("nv12", 0.01, "the first plane is the grey image"),
    "bayer_png": ("bayer_png", 3.0, "a mosaic in a PNG: the images are blurred by a pixel"),
    "colour": ("rgb8", 0.01, "the luma of equal red, green and blue is that value"),
    "bayer": ("bayer_rggb8", 3.0, "a mosaic is interpolated: the images are blurred by a pixel"),
    "yuv_yuyv": ("yuyv", 0.01, "the luma is the grey image"),
    "yuv_uyvy": ("uyvy", 0.01, "the luma is the grey image"),
}


def encoded(encoding: str) -> Make:
    ending = "/compressed" if encoding in ("jpeg", "png", "bayer_png") else ""
    return lambda folder, drive: Made(stereo(drive, ending, encoding=encoding).write(folder / encoding))


for _name, (_encoding, _loses, _why) in ENCODED.items():
    row(_loses, _why)(encoded(_encoding), _name)


@row(0.01, "P alone describes rectified images, as image_proc publishes them beside the raw camera_info")
def rectified_beside_raw_info(folder: Path, drive: Drive) -> Made:
    recording = stereo(drive)
    for _, topic, message in recording.messages:
        if topic.endswith("camera_info"):
            message.d[:] = (-0.1, 0.02, 0.001, -0.001, 0.0)
            message.k[:] *= 1.03
    return Made(recording.write(folder / "bag"))


# ---- no camera_info: a calibration beside the bag

D_LEFT, D_RIGHT = (-0.08, 0.02, 0.0003, -0.0002), (-0.07, 0.015, -0.0002, 0.0001)


def raw_pair(drive: Drive) -> Drive:
    """Return the drive with the images of cameras with distortion."""
    k = drive.rig.camera_matrix
    u, v = np.meshgrid(np.arange(drive.rig.width, dtype=np.float64), np.arange(drive.rig.height, dtype=np.float64))
    pixels = np.stack((u.reshape(-1), v.reshape(-1)), 1)[:, None]
    maps = []
    for d in (D_LEFT, D_RIGHT):
        seen = cv2.undistortPoints(pixels, k, np.array(d), P=k).reshape(*u.shape, 2).astype(np.float32)
        maps.append(seen)
    images = [
        tuple(cv2.remap(image, m, None, cv2.INTER_CUBIC) for image, m in zip(pair, maps, strict=True))
        for pair in drive.images
    ]
    return Drive(drive.rig, images, drive.positions, drive.quats_xyzw, drive.nav_rig, drive.nav)  # type: ignore[arg-type]


def without_info(folder: Path, drive: Drive, *, raw: bool) -> Path:
    left, right = (f"/stereo/{side}/image_{'raw' if raw else 'rect'}" for side in ("left", "right"))
    seen = raw_pair(drive) if raw else drive
    return camera_of(seen, left, right, STEREO[2], STEREO_LINKS, infos=None).write(folder / "no_info")


def kalibr_chain(folder: Path, drive: Drive) -> Path:
    """Write the calibration of two raw cameras in the format of Kalibr."""
    rig, file = drive.rig, folder / "camchain.yaml"
    cameras = {}
    for name, d in (("cam0", D_LEFT), ("cam1", D_RIGHT)):
        side = "left" if name == "cam0" else "right"
        cameras[name] = {
            **({"T_cn_cnm1": moved(-rig.baseline_m).matrix.tolist()} if name == "cam1" else {}),
            "cam_overlaps": [1 - int(name[-1])],
            "camera_model": "pinhole",
            "distortion_coeffs": list(d),
            "distortion_model": "radtan",
            "intrinsics": [rig.fx, rig.fy, rig.cx, rig.cy],
            "resolution": [rig.width, rig.height],
            "rostopic": f"/stereo/{side}/image_raw",
        }
    file.write_text(yaml.safe_dump(cameras))
    return file


@row(5.0, "images are distorted and rectified again: two interpolations, and a border that is lost")
def kalibr_yaml(folder: Path, drive: Drive) -> Made:
    return Made(without_info(folder, drive, raw=True), kalibr_chain(folder, drive))


@row(5.0, "images are distorted and rectified again")
def image_folder(folder: Path, drive: Drive) -> Made:
    """PNG files named by their stamps, with the ground truth of another program beside them."""
    place, rig = folder / "photos", drive.rig
    for side, name in enumerate(("left", "right")):
        (place / name).mkdir(parents=True)
        for stamp_ns, pair in zip(drive.stamps_ns, raw_pair(drive).images, strict=True):
            cv2.imwrite(str(place / name / f"{stamp_ns}.png"), pair[side])
    lines = [(seconds(s), *pose_.translation.tolist(), *pose_.quat_xyzw.tolist()) for s, pose_ in drive.truth(5)]
    truth = table(folder / "truth.tum", "# t x y z qx qy qz qw", lines, " ")
    assert rig.T_rb_sb is not None
    own = {"truth.source": str(truth), "extrinsics.translation_m": rig.T_rb_sb.translation.tolist()}
    own["extrinsics.quat_xyzw"] = rig.T_rb_sb.quat_xyzw.tolist()
    return Made(place, kalibr_chain(folder, drive), own)


def moved(x_m: float) -> Transform:
    return Transform(np.eye(3), np.array([x_m, 0.0, 0.0]))


@row(5.0, "images are distorted and rectified again")
def ros_yaml(folder: Path, drive: Drive) -> Made:
    rig, k = drive.rig, drive.rig.camera_matrix
    place = folder / "calibration"
    place.mkdir()
    for side, d in (("left", D_LEFT), ("right", D_RIGHT)):
        p = np.c_[k, [-rig.fx * rig.baseline_m * (side == "right"), 0.0, 0.0]]
        matrices = {"camera_matrix": k, "rectification_matrix": np.eye(3), "projection_matrix": p}
        matrices["distortion_coefficients"] = np.array([[*d, 0.0]])
        content: dict[str, Any] = {
            "image_width": rig.width,
            "image_height": rig.height,
            "camera_name": f"stereo/{side}",
        }
        content |= {
            n: {"rows": m.shape[0], "cols": m.shape[1], "data": m.reshape(-1).tolist()} for n, m in matrices.items()
        }
        (place / f"{side}.yaml").write_text(yaml.safe_dump(content | {"distortion_model": "plumb_bob"}))
    return Made(without_info(folder, drive, raw=True), place)


@row(5.0, "images are distorted and rectified again")
def opencv_yaml(folder: Path, drive: Drive) -> Made:
    file = folder / "stereo.yml"
    storage = cv2.FileStorage(str(file), cv2.FILE_STORAGE_WRITE)
    k, T_right_left = drive.rig.camera_matrix, moved(-drive.rig.baseline_m)
    values = {"M1": k, "D1": np.array([D_LEFT]), "M2": k, "D2": np.array([D_RIGHT])}
    for name, value in {**values, "R": T_right_left.rotation, "T": T_right_left.translation}.items():
        storage.write(name, value)
    storage.release()
    return Made(without_info(folder, drive, raw=True), file)


@row(0.01, "rectified images with exact intrinsics, of COLMAP's half-pixel convention")
def colmap(folder: Path, drive: Drive) -> Made:
    rig, place = drive.rig, folder / "colmap"
    place.mkdir()
    numbers = [rig.fx, rig.fy, rig.cx + 0.5, rig.cy + 0.5]  # the centre of the first pixel is (0.5, 0.5) there
    text = "".join(f"{k} PINHOLE {rig.width} {rig.height} {' '.join(map(str, numbers))}\n" for k in (1, 2))
    (place / "cameras.txt").write_text("# Camera list with one line of data per camera:\n" + text)
    right = {"image_prefix": "right/", "cam_from_rig_rotation": [1, 0, 0, 0]}
    right |= {"cam_from_rig_translation": [-rig.baseline_m, 0, 0]}
    model = {"camera_model_name": "PINHOLE", "camera_params": numbers}
    cameras = [{"image_prefix": "left/", "ref_sensor": True} | model, right | model]
    (place / "rig_config.json").write_text(json.dumps([{"cameras": cameras}]))
    return Made(without_info(folder, drive, raw=False), place)


def write_rig(folder: Path, drive: Drive) -> Path:
    file = folder / "rig.json"
    file.write_text(rig_text(drive.rig))
    return file


@row(0.01, "rectified images with exact intrinsics")
def rig_json(folder: Path, drive: Drive) -> Made:
    return Made(without_info(folder, drive, raw=False), write_rig(folder, drive))


def in_one_image(folder: Path, drive: Drive, join: Callable[[Sequence[Any]], Any]) -> Path:
    recording = Recording()
    for stamp_ns, pair in zip(drive.stamps_ns, drive.images, strict=True):
        recording.add("/stereo/image_raw", stamp_ns, ENCODE["mono8"](join(pair), header(stamp_ns, "left_optical")))
    add_static(recording, drive, [*STEREO_LINKS, "left_optical"], "right_optical")
    add_truth(recording, drive)
    return recording.write(folder / "one_image")


for _name, _join in {"side_by_side": np.hstack, "top_bottom": np.vstack}.items():
    row(0.01, "the same grey images")(
        lambda folder, drive, join=_join: Made(in_one_image(folder, drive, join), write_rig(folder, drive)), _name
    )


# ---- stamps


APART: dict[str, Callable[[int], int]] = {
    "apart_3ms": lambda n: 3_000_000 + 40_000 * (n % 5),
    "apart_8ms": lambda n: 8_000_000 * (-1) ** n,
    "constant_offset": lambda n: 37_000_000,
}
for _name, _late in APART.items():
    row(0.01, "the same images; the stamp of the left one counts")(
        lambda folder, drive, late=_late: Made(stereo(drive, right_late_ns=late).write(folder / "apart")), _name
    )


# ---- extrinsics


@row(0.01, "the chain of transforms is that of the plain recording")
def deep_frames(folder: Path, drive: Drive) -> Made:
    links = ("base_footprint", "chassis", "deck", "mast", "head", "camera_link", "camera_left_frame")
    return Made(camera_of(drive, *STEREO, links).write(folder / "deep"))


@row(0.01, "the chain of transforms is that of the plain recording")
def two_base_frames(folder: Path, drive: Drive) -> Made:
    links = ("base_footprint", "base_link", "camera_link", "camera_left_frame")
    return Made(camera_of(drive, *STEREO, links).write(folder / "bases"), settings={"frames.base": "base_footprint"})


def add_mapping(recording: Recording, drive: Drive, prefix: str, head_by: str) -> Recording:
    """Add three mapping pairs of a panning head before the drive; LM is RB, and `head_by` is pose, joints or tf."""
    angles, T_head_sb = PanoramaConfig(), rig_extrinsics(NavCamerasConfig())
    turns = [*zip(np.radians(angles.pan_deg), np.radians(angles.tilt_deg), strict=True)]
    T_rb_lm = mast_head_in_rb(*turns[0]) @ T_head_sb @ drive.nav[0].T_lm_navsb.inverse()
    for k, ((pan, tilt), item) in enumerate(zip(turns, drive.nav, strict=True)):
        stamp_ns, T_rb_head = BEGIN_NS + (k - 3) * 1_000_000_000, mast_head_in_rb(float(pan), float(tilt))
        at_rest = Transform(np.eye(3), T_rb_head.translation)
        for about_ns in (stamp_ns - 15_000_000, stamp_ns + 15_000_000):  # joints have other stamps than images
            head = header(about_ns, "")
            if head_by == "joints":
                names, values = ["wheel_left", "pan_joint", "tilt_joint"], np.array([0.3, pan, tilt])
                state = T["sensor_msgs/msg/JointState"](head, names, values, np.zeros(0), np.zeros(0))
                recording.add("/joint_states", about_ns, state)
            elif head_by == "tf":
                turned = transform(about_ns, "mast", "head", Transform(T_rb_head.rotation, np.zeros(3)))
                recording.add("/tf", about_ns, T["tf2_msgs/msg/TFMessage"]([turned]))
        if head_by == "pose":
            kind = T["geometry_msgs/msg/PoseStamped"]
            recording.add("/nav/pose", stamp_ns, kind(header(stamp_ns, "lm"), pose(T_rb_head @ T_head_sb)))
        for side, grey in (("left", item.pair.left), ("right", item.pair.right)):
            head = header(stamp_ns, f"pancam_{side}_optical")
            p3 = -drive.nav_rig.fx * drive.nav_rig.baseline_m * (side == "right")
            recording.add(f"{prefix}/{side}/image_rect", stamp_ns, ENCODE["mono8"](grey, head))
            recording.add(f"{prefix}/{side}/camera_info", stamp_ns, camera_info(drive, head, p3, nav=True))
        assert item.truth is not None
        known = np.ascontiguousarray(T_rb_lm.apply(item.truth.reshape(-1, 3)).astype("<f4"))
        h, w = item.truth.shape[:2]
        fields = [T["sensor_msgs/msg/PointField"](name, 4 * k, 7, 1) for k, name in enumerate("xyz")]
        layout = (h, w, fields, False, 12, 12 * w, known.view(np.uint8).reshape(-1), False)
        points = T["sensor_msgs/msg/PointCloud2"](header(stamp_ns, "base_link"), *layout)
        recording.add("/ground_truth/points", stamp_ns, points)
    if head_by != "pose":
        T_head_left = T_head_sb @ drive.nav_rig.T_sb_left
        edges = [("base_link", "mast", at_rest), ("head", "pancam_left_optical", T_head_left)]
        recording.add("/tf_static", BEGIN_NS, T["tf2_msgs/msg/TFMessage"]([transform(BEGIN_NS, *e) for e in edges]))
    return recording


@row(0.001, "the same head, from its angles", figure="map")
def pan_tilt_joints(folder: Path, drive: Drive) -> Made:
    cameras = NavCamerasConfig()
    position_m = [cameras.x_m, cameras.y_m, cameras.z_m]
    place = {"frames.head_to_navsb_m": position_m, "frames.head_to_navsb_quat_xyzw": [0.0, 0.0, 0.0, 1.0]}
    return Made(add_mapping(stereo(drive), drive, "/pancam", "joints").write(folder / "head"), settings=place)


@row(0.001, "the same head, from its angles", figure="map")
def pan_tilt_tf(folder: Path, drive: Drive) -> Made:
    return Made(add_mapping(stereo(drive), drive, "/pancam", "tf").write(folder / "head"))


# ---- truths


def truth_by(drive: Drive, topic: str, message: Callable[[Any, Transform], Any], rate: int = 5) -> Recording:
    """Return a drive with the ground truth on a topic of another type and at another rate."""
    recording = stereo(drive, truth=False)
    for stamp_ns, T_ds_rb in drive.truth(rate):
        recording.add(topic, stamp_ns, message(header(stamp_ns, "world"), T_ds_rb))
    return recording


@row(0.01, "true poses at all stamps")
def truth_odometry(folder: Path, drive: Drive) -> Made:
    recording = truth_by(drive, "/odometry/optitrack", lambda head, T_ds_rb: odometry(head, "base_link", T_ds_rb))
    for stamp_ns, T_ds_rb in drive.truth():  # wheel odometry is not a ground truth
        slipped = Transform(T_ds_rb.rotation, 0.9 * T_ds_rb.translation)
        recording.add("/wheel_odom", stamp_ns, odometry(header(stamp_ns, "odom"), "base_link", slipped))
    return Made(recording.write(folder / "bag"), settings={"truth.source": "/odometry/optitrack"})


def stamp_of(head: Any) -> int:
    return int(head.stamp.sec * 10**9 + head.stamp.nanosec)


TRUTHS: dict[str, tuple[str, Callable[[Any, Transform], Any]]] = {
    "truth_pose": (
        "/vrpn_mocap/rover/pose",
        lambda head, T_ds_rb: T["geometry_msgs/msg/PoseStamped"](head, pose(T_ds_rb)),
    ),
    "truth_pose_with_covariance": (
        "/gt_pose",
        lambda head, T_ds_rb: T["geometry_msgs/msg/PoseWithCovarianceStamped"](head, with_covariance(T_ds_rb, 0.002)),
    ),
    "truth_transform": (
        "/vicon/rover/rover",
        lambda head, T_ds_rb: transform(stamp_of(head), "vicon/world", "vicon/rover/rover", T_ds_rb),
    ),
}
for _name, (_topic, _message) in TRUTHS.items():
    row(0.01, "true poses at all stamps")(
        lambda folder, drive, by=(_topic, _message): Made(truth_by(drive, *by).write(folder / "bag")), _name
    )


@row(0.01, "true poses at all stamps")
def truth_path(folder: Path, drive: Drive) -> Made:
    recording, poses = stereo(drive, truth=False), []
    for stamp_ns, T_ds_rb in drive.truth():
        poses.append(T["geometry_msgs/msg/PoseStamped"](header(stamp_ns, "map"), pose(T_ds_rb)))
        recording.add("/gt_path", stamp_ns, T["nav_msgs/msg/Path"](header(stamp_ns, "map"), [*poses]))
    return Made(recording.write(folder / "bag"))


@row(0.01, "true poses at all stamps")
def truth_tf(folder: Path, drive: Drive) -> Made:
    recording = stereo(drive, truth=False)
    for stamp_ns, T_ds_rb in drive.truth(5):
        moving = transform(stamp_ns, "map", "base_link", T_ds_rb)
        recording.add("/tf", stamp_ns, T["tf2_msgs/msg/TFMessage"]([moving]))
    return Made(recording.write(folder / "bag"), settings={"truth.frame": "map:base_link"})


@row(2.0, "positions alone: chords have no direction, and the origin is a fix", figure="chord")
def truth_nav_sat_fix(folder: Path, drive: Drive) -> Made:
    antenna, first = np.array(ANTENNA_M), drive.positions[0]
    recording = truth_by(drive, "/fix", lambda head, T_ds_rb: nav_sat_fix(head, T_ds_rb.apply(antenna) - first, 0.008))
    return Made(recording.write(folder / "bag"), settings={"truth.lever_arm_m": list(ANTENNA_M)})


@row(2.0, "positions alone, of a prism: chords have no direction", figure="chord")
def truth_points(folder: Path, drive: Drive) -> Made:
    prism, kind = np.array(ANTENNA_M), T["geometry_msgs/msg/PointStamped"]
    by = "/leica/position", lambda head, T_ds_rb: kind(head, vector("Point", T_ds_rb.apply(prism)))
    return Made(truth_by(drive, *by).write(folder / "bag"), settings={"truth.lever_arm_m": list(ANTENNA_M)})


@row(2.0, "positions alone, of an antenna: chords have no direction", figure="chord")
def nav2_rover(folder: Path, drive: Drive) -> Made:
    names = [f"/front_stereo_camera/{side}/image_rect" for side in ("left", "right")]
    frames = ("front_stereo_camera_left_optical", "front_stereo_camera_right_optical")
    links = ("base_link", "chassis_link", "front_stereo_camera_link", "front_stereo_camera_left")
    recording = camera_of(drive, *names, frames, links, encoding="rgb8", truth=False)
    for stamp_ns, T_ds_rb in drive.truth(5):
        wheels = Transform(T_ds_rb.rotation, 0.93 * T_ds_rb.translation)
        recording.add("/odom", stamp_ns, odometry(header(stamp_ns, "odom"), "base_link", wheels))
        moving = transform(stamp_ns, "odom", "base_link", wheels)
        recording.add("/tf", stamp_ns, T["tf2_msgs/msg/TFMessage"]([moving]))
        enu_m = T_ds_rb.apply(np.array(ANTENNA_M)) - drive.positions[0]
        recording.add("/gps/fix", stamp_ns, nav_sat_fix(header(stamp_ns, "gps_link"), enu_m, 0.008))
    own = {"truth.source": "/gps/fix", "truth.lever_arm_m": list(ANTENNA_M)}
    return Made(recording.write(folder / "nav2"), settings=own)


@row(0.3, "markers in single precision, their frame turned and moved")
def motion_capture_lab(folder: Path, drive: Drive) -> Made:
    T_rb_body, kind = Transform.from_quat(ANTENNA_M, MARKERS_XYZW), T["geometry_msgs/msg/PoseStamped"]
    lever = {"truth.lever_arm_m": list(ANTENNA_M), "truth.lever_quat_xyzw": list(MARKERS_XYZW)}
    by = "/vrpn_mocap/rover/pose", lambda head, T_ds_rb: kind(head, pose(T_ds_rb @ T_rb_body))
    return Made(truth_by(drive, *by).write(folder / "lab"), settings=lever | {"truth.sigma_m": 0.001})


def table(file: Path, heading: str, lines: Sequence[Sequence[Any]], separator: str = ",") -> Path:
    text = [heading, *(separator.join(str(value) for value in line) for line in lines)]
    file.write_text("\n".join(text) + "\n")
    return file


def seconds(stamp_ns: int) -> str:
    return f"{stamp_ns // 10**9}.{stamp_ns % 10**9:09d}"


def with_file(folder: Path, drive: Drive, file: Path, settings: dict[str, Any] | None = None) -> Made:
    return Made(
        stereo(drive, truth=False).write(folder / "bag"), settings={"truth.source": str(file), **(settings or {})}
    )


@row(2.0, "positions alone, in tenths of a millimetre: chords have no direction", figure="chord")
def truth_total_station(folder: Path, drive: Drive) -> Made:
    prism = np.array(ANTENNA_M)
    places = [(stamp_ns, T_ds_rb.apply(prism) + np.array([500.0, 300.0, 12.0])) for stamp_ns, T_ds_rb in drive.truth(1)]
    lines = [(seconds(stamp_ns), *(f"{value:.4f}" for value in place)) for stamp_ns, place in places]
    file = table(folder / "prism.csv", "time [s],east [m],north [m],height [m]", lines)
    return with_file(folder, drive, file, {"truth.lever_arm_m": list(ANTENNA_M)})


@row(0.3, "markers in hundredths of a millimetre")
def truth_motion_capture(folder: Path, drive: Drive) -> Made:
    T_rb_body, lines = Transform.from_quat(ANTENNA_M, MARKERS_XYZW), []
    for stamp_ns, T_ds_rb in drive.truth(5):
        body = T_ds_rb @ T_rb_body
        numbers = [*(f"{value:.5f}" for value in body.translation), *(f"{value:.9f}" for value in body.quat_xyzw)]
        lines.append((seconds(stamp_ns), *numbers))
    file = table(folder / "markers.csv", "timestamp,x,y,z,qx,qy,qz,qw", lines)
    own = {"truth.lever_arm_m": list(ANTENNA_M), "truth.lever_quat_xyzw": list(MARKERS_XYZW)}
    units = {
        "t": "timestamp[s]",
        **{name: f"{name}[m]" for name in "xyz"},
        **{f"q{name}": f"q{name}" for name in "xyzw"},
    }
    own["truth.columns"] = ",".join("=".join(item) for item in units.items())  # the header has no units
    return with_file(folder, drive, file, own)


@row(0.01, "numbers in full")
def truth_tum(folder: Path, drive: Drive) -> Made:
    lines = [(seconds(s), *pose_.translation.tolist(), *pose_.quat_xyzw.tolist()) for s, pose_ in drive.truth(5)]
    return with_file(folder, drive, table(folder / "truth.tum", "# t x y z qx qy qz qw", lines, " "))


@row(0.05, "numbers in full, of the left camera, from its first pose on")
def truth_kitti(folder: Path, drive: Drive) -> Made:
    T_rb_left = drive.rig.T_rb_left
    cameras = [T_ds_rb @ T_rb_left for _, T_ds_rb in drive.truth()]
    lines = [(cameras[0].inverse() @ pose_).matrix[:3].reshape(-1).tolist() for pose_ in cameras]
    file = folder / "poses.kitti"
    file.write_text("\n".join(" ".join(map(repr, line)) for line in lines) + "\n")
    (folder / "times.txt").write_text("\n".join(seconds(stamp_ns) for stamp_ns in drive.stamps_ns) + "\n")
    body = T_rb_left @ OPTICAL.inverse()  # the reader rotates the axes of the file to x forward
    turn = body.quat_xyzw.tolist()
    lever = {"truth.lever_arm_m": body.translation.tolist(), "truth.lever_quat_xyzw": turn}
    return with_file(folder, drive, file, lever)


@row(0.01, "numbers in full")
def truth_euroc(folder: Path, drive: Drive) -> Made:
    lines = []
    for stamp_ns, T_ds_rb in drive.truth(5):
        x, y, z, w = T_ds_rb.quat_xyzw.tolist()
        lines.append((stamp_ns, *T_ds_rb.translation.tolist(), w, x, y, z, *[0.0] * 9))
    heading = "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], v"
    return with_file(folder, drive, table(folder / "data.csv", heading, lines))


# ---- bags


def rosbags_convert(source: Path, destination: Path) -> Path:
    command = [str(Path(sys.executable).parent / "rosbags-convert"), "--src", str(source), "--dst", str(destination)]
    subprocess.run(command, check=True, capture_output=True)
    return destination


@row(0.01, "the same messages")
def ros1_by_rosbags_convert(folder: Path, drive: Drive) -> Made:
    return Made(rosbags_convert(stereo(drive).write(folder / "ros2"), folder / "converted.bag"))


@row(0.01, "the same messages")
def ros1_by_rosbag(folder: Path, drive: Drive) -> Made:
    noetic, file = get_typestore(Stores.ROS1_NOETIC), folder / "recorded.bag"
    frames = "tf2_msgs/msg/TFMessage"  # not in the library's types
    if frames not in noetic.fielddefs:
        noetic.register({frames: STORE.fielddefs[frames]})
    with Ros1Writer(file) as writer:
        made: dict[str, Any] = {}
        for stamp_ns, topic, message in sorted(stereo(drive).messages, key=lambda item: item[0]):
            kind = message.__msgtype__
            if topic not in made:
                definition, digest = noetic.generate_msgdef(kind, ros_version=1)
                made[topic] = writer.add_connection(topic, kind, msgdef=definition, md5sum=digest)
            raw = STORE.cdr_to_ros1(STORE.serialize_cdr(message, kind), kind)
            writer.write(made[topic], stamp_ns, raw)
    return Made(file)


@row(0.01, "the same messages")
def ros2_of_ros1_by_rosbags_convert(folder: Path, drive: Drive) -> Made:
    return Made(rosbags_convert(ros1_by_rosbag(folder, drive).source, folder / "back"))


@row(0.01, "the same messages")
def sqlite3(folder: Path, drive: Drive) -> Made:
    return Made(stereo(drive).write(folder / "db3", "sqlite3"))


class _ForeignMcapWriter(McapWriter):
    def add_msgtype(self, connection: Any) -> None:
        super().add_msgtype(connection)
        if "/" not in connection.msgtype:
            self.schemas[-1] = Schema(len(self.schemas), connection.msgtype, "protobuf", connection.msgdef.data)


class _ForeignWriter(Writer):
    STORAGE_PLUGINS = MappingProxyType({StoragePlugin.MCAP: _ForeignMcapWriter})


@row(0.01, "the same messages, among others that are not of ROS")
def mcap_with_foreign_schemas(folder: Path, drive: Drive) -> Made:
    with _ForeignWriter(folder / "mixed", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        made: dict[str, Any] = {}
        made["/tf_proto"] = writer.add_connection(
            "/tf_proto",
            "foxglove.FrameTransform",
            msgdef="\n\x03abc",
            rihs01="RIHS01_",
            serialization_format="protobuf",
        )
        own = "sfr_made_msgs/msg/Battery"
        made["/battery"] = writer.add_connection("/battery", own, msgdef="float32 volts\n", rihs01="RIHS01_")
        for stamp_ns, topic, message in sorted(stereo(drive).messages, key=lambda item: item[0]):
            kind = message.__msgtype__
            if topic not in made:
                made[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(made[topic], stamp_ns, STORE.serialize_cdr(message, kind))
            writer.write(made["/tf_proto"], stamp_ns, b"\x08\x01")
            writer.write(made["/battery"], stamp_ns, b"\0\1\0\0\0\0\xc0\x41")
    return Made(folder / "mixed")


@row(0.01, "the same messages in two files")
def split(folder: Path, drive: Drive) -> Made:
    recording, parts = stereo(drive), []
    middle = len(recording.messages) // 2
    for k, part in enumerate((slice(None, middle), slice(middle, None))):
        parts.append(recording.write(folder / f"part_{k}", part=part))
    about = [yaml.safe_load((part / "metadata.yaml").read_text())["rosbag2_bagfile_information"] for part in parts]
    whole = about[0]
    for k, part in enumerate(parts):
        name = f"{part.name}.mcap"
        (part / name).rename(parts[0] / name)
        whole["files"] = whole["files"] if k == 0 else whole["files"] + about[1]["files"]
    whole["relative_file_paths"] = [f"{part.name}.mcap" for part in parts]
    whole["message_count"] += about[1]["message_count"]
    counts = {item["topic_metadata"]["name"]: item["message_count"] for item in about[1]["topics_with_message_count"]}
    for item in whole["topics_with_message_count"]:
        item["message_count"] += counts.pop(item["topic_metadata"]["name"], 0)
    (parts[0] / "metadata.yaml").write_text(yaml.safe_dump({"rosbag2_bagfile_information": whole}))
    return Made(parts[0])


@row(2.5, "the last pairs are missing, and with them a start")
def cut_short(folder: Path, drive: Drive) -> Made:
    file = stereo(drive).write(folder / "cut") / "cut.mcap"
    (folder / "cut" / "metadata.yaml").unlink()
    data = file.read_bytes()
    file.write_bytes(data[: int(0.97 * len(data))])
    return Made(file)
