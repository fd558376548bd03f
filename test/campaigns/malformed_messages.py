"""Malformed messages, derived from valid messages: class, topic, and the message or its bytes."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from geometry_msgs.msg import Point, Pose, PoseStamped, PoseWithCovarianceStamped, Quaternion
from nav_msgs.msg import Odometry
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2, PointField
from std_msgs.msg import String

from helpers.node_scenes import raw
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.io.bag import messages as bag_messages
from sfr_loc_map.ros.messages import header_msg
from sfr_loc_map.suite_names import SIDES

NAN, HUGE = math.nan, 2**32 - 1
PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
Malformed = tuple[type[Any], str, Any]


def images(task: str, pair: StereoPair, next_stamp: Callable[[], int]) -> Iterator[Malformed]:
    """Yield malformed images in pairs with equal stamps, so that each image is decoded."""
    height, width = pair.left.shape
    data = pair.left.tobytes()
    changes: list[dict[str, Any]] = [{"step": step} for step in (0, width - 1, 2 * width, HUGE)]
    sizes = ((0, 0), (HUGE, HUGE), (height // 2, width))
    changes += [{"height": h, "width": w} for h, w in sizes]
    changes += [{"height": 65_536, "width": 65_536, "step": 65_536}]
    changes += [{"data": bytes(length)} for length in (0, 1, len(data) - 1, 2 * len(data))]
    encodings = ("", "mono8 ", "yuv422", "bayer_rggb8", "32FC1", "64FC4", "mono16", "rgb8", "x" * 1_000_000)
    changes += [{"encoding": encoding} for encoding in encodings]
    floats = np.full((height, width), NAN, "<f4").tobytes()
    changes += [{"encoding": "32FC1", "step": 4 * width, "data": floats}]
    for change in changes:
        fields = {"height": height, "width": width, "encoding": "mono8", "step": width, "data": data} | change
        message = Image(header=header_msg(next_stamp(), ""), **fields)
        yield from ((Image, f"{task}/{side}/image_rect", message) for side in SIDES)


def compressed_images(task: str, pair: StereoPair, next_stamp: Callable[[], int]) -> Iterator[Malformed]:
    """Yield malformed compressed images in pairs with equal stamps, for a node without raw images."""
    height, width = pair.left.shape
    claims = [b"".join(n.to_bytes(4, "big") for n in size) for size in ((65_535, 65_535), (width, height))]
    heads = [PNG_MAGIC + (13).to_bytes(4, "big") + b"IHDR" + claim + b"\x08\0\0\0\0" + bytes(64) for claim in claims]
    for content in (*heads, b"\xff\xd8\xff\xe0\x00\x10JFIF", b"", np.random.default_rng(1).bytes(5000)):
        compressed = CompressedImage(header=header_msg(next_stamp(), ""), format="png", data=content)
        yield from ((CompressedImage, f"{task}/{side}/image_rect/compressed", compressed) for side in SIDES)


def broken_bytes(task: str, pair: StereoPair, rig: StereoRig) -> Iterator[Malformed]:
    """Yield serialised images and camera_info that are truncated or have wrong length fields; none is empty."""
    image = raw(bag_messages.image(pair.stamp_ns, pair.left, task, "left"))
    info = raw(bag_messages.camera_info(pair.stamp_ns, rig, task, "left"))
    for kind, name, data in ((Image, "image_rect", image), (CameraInfo, "camera_info", info)):
        cut = [data[:length] for length in (4, 5, 12, 15, 40, len(data) // 2, len(data) - 1)]
        frame_of_4_gb = data[:12] + b"\xff\xff\xff\xff" + data[16:]
        noise = b"\x00\x01\x00\x00" + np.random.default_rng(2).bytes(4000)
        other_encoding = b"\xff\xff\xff\xff" + data[4:]
        yield from ((kind, f"{task}/left/{name}", part) for part in (*cut, frame_of_4_gb, noise, other_encoding))
    at = len(image) - pair.left.size - 4
    yield Image, f"{task}/left/image_rect", image[:at] + b"\xff\xff\xff\x7f" + image[at + 4 :]  # 2 GB


def camera_infos(task: str, stamp_ns: int, rig: StereoRig) -> Iterator[Malformed]:
    """Yield camera_info in pairs of left and right."""
    for change in (
        *({"k": np.full(9, value), "p": np.full(12, value)} for value in (NAN, 0.0)),
        {"p": np.full(12, 1e308)},
        *({"width": size, "height": size} for size in (HUGE, 0)),
        {"r": np.zeros(9)},
        {"d": [0.1] * 1_000_000},
    ):
        for side in SIDES:
            valid = bag_messages.camera_info(stamp_ns, rig, task, side)
            fields: dict[str, Any] = {"height": rig.height, "width": rig.width, "distortion_model": "plumb_bob"}
            fields |= {"d": [0.0] * 5, "r": np.eye(3).reshape(-1)}
            fields |= {name: np.asarray(getattr(valid, name), np.float64) for name in ("k", "p")} | change
            yield CameraInfo, f"{task}/{side}/camera_info", CameraInfo(header=header_msg(stamp_ns, ""), **fields)


def poses() -> Iterator[Pose]:
    """Yield invalid poses."""
    for x, quat in (
        *((x, (0.0, 0.0, 0.0, 1.0)) for x in (NAN, math.inf, 1e300)),
        *((0.0, quat) for quat in ((0.0, 0.0, 0.0, 0.0), (NAN, 0.0, 0.0, 1.0), (1e200, 0.0, 0.0, 0.0))),
    ):
        yield Pose(position=Point(x=x), orientation=Quaternion(**dict(zip("xyzw", quat, strict=True))))


def poses_for(task: str, stamp_ns: int) -> Iterator[Malformed]:
    """Yield invalid initialpose and wheel odometry, or poses of navigation pairs."""
    for number, pose in enumerate(poses()):
        if task == "nav":
            yield PoseStamped, "nav/pose", PoseStamped(header=header_msg(stamp_ns + number, "lm"), pose=pose)
            continue
        start, wheels = PoseWithCovarianceStamped(header=header_msg(stamp_ns, "")), Odometry(child_frame_id="rb")
        start.pose.pose = wheels.pose.pose = pose
        yield PoseWithCovarianceStamped, "initialpose", start
        yield Odometry, "motion_prior", wheels
    if task == "loc":
        elsewhere = PoseWithCovarianceStamped(header=header_msg(stamp_ns, "mars"))
        yield PoseWithCovarianceStamped, "initialpose", elsewhere


def for_monitor(stamp_ns: int) -> Iterator[Malformed]:
    """Yield malformed estimates, ground truth, calls, clouds and configurations."""
    for pose in poses():
        for topic in ("localisation/odometry", "ground_truth/odometry"):
            odometry = Odometry(header=header_msg(stamp_ns, "ds"), child_frame_id="rb")
            odometry.pose.pose = pose
            yield Odometry, topic, odometry
    valid = {"stamp_ns": stamp_ns, "state": "tracking", "processing_time_s": 0.1}
    for change in (
        *({"processing_time_s": value} for value in ("abc", None, -1.0, 1e300)),
        *({"stamp_ns": value} for value in (10**30, -1, "1")),
        {"peak_rss_bytes": 10**30, "above_idle_bytes": 1},
        *({"state": "cooking"}, {"statistics": {"x": "y"}}, {"step": [1.0]}, {"covariance": [[]]}),
    ):
        yield String, "localisation_node/call", String(data=json.dumps(valid | change))
    for text in ("", "{", "[" * 100_000, "7"):
        yield String, "localisation_node/call", String(data=text)
    fields, far = (
        [PointField(name=name, offset=offset + 4 * n, datatype=7, count=1) for n, name in enumerate("xyz")]
        for offset in (0, HUGE - 11)
    )
    whole: dict[str, Any] = {"height": 1, "width": 4, "fields": fields, "point_step": 12, "row_step": 48}
    for change in (
        *({"fields": []}, {"fields": far}, {"data": b""}),
        {"height": HUGE, "width": HUGE},
        *({"point_step": step, "row_step": step} for step in (0, HUGE)),
    ):
        for topic in ("mapping/points", "ground_truth/points"):
            given = whole | {"data": bytes(48)} | change
            yield PointCloud2, topic, PointCloud2(header=header_msg(stamp_ns, "lm"), **given)
    for text in ("", "{", "[" * 100_000, "7", json.dumps({"x": "y" * 1_000_000})):
        yield String, "localisation/configuration", String(data=text)
