"""Messages like those of drivers, and the bags that contain them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from campaigns.recordings.drive import Drive
from sfr_loc_map.geometry.arrays import FloatArray, GreyImage
from sfr_loc_map.geometry.transform import Transform

STORE = get_typestore(Stores.ROS2_JAZZY)
T = STORE.types
NEVER = QosTime(0, 0)
LATCHED = Qos(
    *(QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL),
    *(NEVER, NEVER, QosLiveliness.AUTOMATIC, NEVER, False),
)
OPTICAL = Transform(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), np.zeros(3))
"""An optical frame (x right, y down, z forward) in a frame with x forward, y left, z up."""
Encode = Callable[[GreyImage, Any], Any]


class Recording:
    """Messages in any order, which are written in the order of their stamps."""

    def __init__(self) -> None:
        self.messages: list[tuple[int, str, Any]] = []

    def add(self, topic: str, stamp_ns: int, message: Any) -> None:
        self.messages.append((stamp_ns, topic, message))

    def write(self, path: Path, storage: str = "mcap", part: slice = slice(None)) -> Path:
        """Write a ROS 2 bag with a part of the sorted messages."""
        with Writer(path, version=9, storage_plugin=StoragePlugin[storage.upper()]) as writer:
            made: dict[str, Any] = {}
            for stamp_ns, topic, message in sorted(self.messages, key=lambda item: item[0])[part]:
                kind = message.__msgtype__
                if topic not in made:
                    qos = [LATCHED] if topic.endswith("tf_static") else []
                    made[topic] = writer.add_connection(topic, kind, typestore=STORE, offered_qos_profiles=qos)
                writer.write(made[topic], stamp_ns, STORE.serialize_cdr(message, kind))
        return path


def header(stamp_ns: int, frame: str) -> Any:
    return T["std_msgs/msg/Header"](T["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 10**9)), frame)


def vector(kind: str, values: Iterable[float]) -> Any:
    return T[f"geometry_msgs/msg/{kind}"](*map(float, values))


# ---- images


def image(encoding: str, pixels: np.ndarray, head: Any) -> Any:
    height, width = pixels.shape[:2]
    data = np.ascontiguousarray(pixels).view(np.uint8).reshape(-1)
    return T["sensor_msgs/msg/Image"](head, height, width, encoding, 0, len(data) // height, data)


def planar(grey: GreyImage, head: Any) -> Any:
    """Return an image whose first plane is the luma; the second plane has the chroma at half resolution."""
    found = image("nv12", grey, head)
    colours = np.full(found.data.size // 2, 128, np.uint8)
    return replace(found, data=np.append(found.data, colours))


def with_luma_at(place: int, encoding: str) -> Encode:
    def encode(grey: GreyImage, head: Any) -> Any:
        samples = np.full((*grey.shape, 2), 128, np.uint8)
        samples[:, :, place] = grey
        return image(encoding, samples, head)

    return encode


def compressed(ending: str, about: str, *settings: int) -> Encode:
    def encode(grey: GreyImage, head: Any) -> Any:
        colour = cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR) if "bgr8" in about else grey
        data = cv2.imencode(ending, colour, settings)[1].reshape(-1)
        return T["sensor_msgs/msg/CompressedImage"](head, about, data)

    return encode


ENCODE: dict[str, Encode] = {
    "mono8": lambda grey, head: image("mono8", grey, head),
    "mono16": lambda grey, head: image("mono16", grey.astype(np.uint16) * 257, head),
    "mono12": lambda grey, head: image("mono16", grey.astype(np.uint16) * 16, head),
    "mono10": lambda grey, head: image("mono16", grey.astype(np.uint16) * 4, head),
    "nv12": lambda grey, head: planar(grey, head),
    "rgb8": lambda grey, head: image("rgb8", np.repeat(grey[:, :, None], 3, 2), head),
    "bgra8": lambda grey, head: image("bgra8", cv2.cvtColor(grey, cv2.COLOR_GRAY2BGRA), head),
    "bayer_rggb8": lambda grey, head: image("bayer_rggb8", grey, head),
    "yuyv": with_luma_at(0, "yuv422_yuy2"),
    "uyvy": with_luma_at(1, "yuv422"),
    "jpeg": compressed(".jpg", "bgr8; jpeg compressed bgr8", cv2.IMWRITE_JPEG_QUALITY, 90),
    "png": compressed(".png", "mono8; png compressed "),
    "bayer_png": compressed(".png", "bayer_rggb8; png compressed "),
}


def camera_info(drive: Drive, head: Any, p3: float, nav: bool = False, d: Sequence[float] = (0.0,) * 5) -> Any:
    """Return the camera_info of a driver; `p3` is -fx baseline for the right camera."""
    rig = drive.nav_rig if nav else drive.rig
    k = rig.camera_matrix
    p = np.c_[k, [p3, 0.0, 0.0]].reshape(-1)
    roi = T["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    rest = {"distortion_model": "plumb_bob", "d": np.array(d), "r": np.eye(3).reshape(-1), "binning_x": 0}
    return T["sensor_msgs/msg/CameraInfo"](
        header=head, height=rig.height, width=rig.width, k=k.reshape(-1), p=p, binning_y=0, roi=roi, **rest
    )


def add_pair(
    recording: Recording,
    drive: Drive,
    images: tuple[str, str],
    infos: tuple[str, str] | None,
    frames: tuple[str, str],
    encoding: str = "mono8",
    right_p3: float | None = None,
    right_late_ns: Callable[[int], int] = lambda n: 0,
) -> None:
    """Add the images of two cameras; `right_late_ns` returns the delay of the n-th right stamp."""
    rig = drive.rig
    for n, (stamp_ns, pair) in enumerate(zip(drive.stamps_ns, drive.images, strict=True)):
        for side in (0, 1):
            head = header(stamp_ns + side * right_late_ns(n), frames[side])
            own = stamp_ns + side * right_late_ns(n)
            recording.add(images[side], own, ENCODE[encoding](pair[side], head))
            if infos is not None:
                p3 = side * (-rig.fx * rig.baseline_m if right_p3 is None else right_p3)
                recording.add(infos[side], own, camera_info(drive, head, p3))


# ---- frames


def transform(stamp_ns: int, parent: str, child: str, T_parent_child: Transform) -> Any:
    motion = T["geometry_msgs/msg/Transform"](
        vector("Vector3", T_parent_child.translation), vector("Quaternion", T_parent_child.quat_xyzw)
    )
    return T["geometry_msgs/msg/TransformStamped"](header(stamp_ns, parent), child, motion)


def add_static(recording: Recording, drive: Drive, chain: Sequence[str], right: str | None = None) -> None:
    """Add /tf_static from the base over intermediate links to the left optical frame."""
    stamp_ns, T_base_left = drive.stamps_ns[0], drive.rig.T_rb_left
    links, edges, so_far = len(chain) - 2, [], Transform.identity()
    for k, (parent, child) in enumerate(pairwise(chain), 1):
        if k <= links - 1:  # arbitrary intermediate poses
            step = Transform.from_quat((0.1 * k, -0.02 * k, 0.15), (0.0, 0.0, math.sin(0.2 * k), math.cos(0.2 * k)))
        else:  # the last link is the camera's body frame, followed by its optical frame
            step = OPTICAL if k > links else so_far.inverse() @ T_base_left @ OPTICAL.inverse()
        so_far = so_far @ step
        edges.append(transform(stamp_ns, parent, child, step))
    if right is not None:
        beside = Transform(np.eye(3), np.array([drive.rig.baseline_m, 0.0, 0.0]))
        edges.append(transform(stamp_ns, chain[-1], right, beside))
    recording.add("/tf_static", stamp_ns, T["tf2_msgs/msg/TFMessage"](edges))


# ---- truths


def pose(T_a_b: Transform) -> Any:
    place, turn = vector("Point", T_a_b.translation), vector("Quaternion", T_a_b.quat_xyzw)
    return T["geometry_msgs/msg/Pose"](place, turn)


def with_covariance(T_a_b: Transform, sigma_m: float = 0.0) -> Any:
    covariance = np.diag([sigma_m**2] * 3 + [0.0] * 3).reshape(-1)
    return T["geometry_msgs/msg/PoseWithCovariance"](pose(T_a_b), covariance)


def odometry(head: Any, child: str, T_a_b: Transform) -> Any:
    still = T["geometry_msgs/msg/Twist"](vector("Vector3", (0, 0, 0)), vector("Vector3", (0, 0, 0)))
    twist = T["geometry_msgs/msg/TwistWithCovariance"](still, np.zeros(36))
    return T["nav_msgs/msg/Odometry"](head, child, with_covariance(T_a_b), twist)


def nav_sat_fix(head: Any, enu_m: FloatArray, sigma_m: float) -> Any:
    """Return a fix at a position east, north and up of 60 N, 24 E (WGS 84), solved by Newton's method."""
    origin = np.array([60.0, 24.0, 20.0])
    place = origin
    for _ in range(6):
        wrong = enu_m - enu_of(place, origin)
        place = place + np.array([wrong[1] / 111_412.0, wrong[0] / 55_800.0, wrong[2]])
    status = T["sensor_msgs/msg/NavSatStatus"](2, 1)
    covariance = np.diag([sigma_m**2] * 3).reshape(-1)
    return T["sensor_msgs/msg/NavSatFix"](head, status, *map(float, place), covariance, 2)


def enu_of(place: FloatArray, origin: FloatArray) -> FloatArray:
    """Return the position east, north, up of an origin given by latitude, longitude, deg, and height, m (WGS 84)."""

    def geocentric(at: FloatArray) -> FloatArray:
        a, e2 = 6_378_137.0, 0.00669437999014
        lat, lon = np.radians(at[:2])
        n = a / math.sqrt(1 - e2 * math.sin(lat) ** 2)
        across = (n + at[2]) * math.cos(lat)
        return np.array([across * math.cos(lon), across * math.sin(lon), (n * (1 - e2) + at[2]) * math.sin(lat)])

    lat, lon = np.radians(origin[:2])
    s, c, sl, cl = math.sin(lat), math.cos(lat), math.sin(lon), math.cos(lon)
    axes = np.array([[-sl, cl, 0.0], [-s * cl, -s * sl, c], [c * cl, c * sl, s]])
    return np.asarray(axes @ (geocentric(place) - geocentric(origin)))
