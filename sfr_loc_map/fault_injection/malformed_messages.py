"""Malformed messages, made from valid ones."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point, Pose, PoseStamped, PoseWithCovarianceStamped, Quaternion
from nav_msgs.msg import Odometry
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2, PointField
from std_msgs.msg import String

from sfr_loc_map.fault_injection.fake_rover import serialised
from sfr_loc_map.geometry.arrays import GreyImage
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.inputs import SIDES
from sfr_loc_map.io import bag_messages
from sfr_loc_map.io.image_codec import PNG_MAGIC
from sfr_loc_map.nodes.messages.fields import header_msg

NAN, HUGE = math.nan, 2**32 - 1
CDR_HEADER = b"\x00\x01\x00\x00"


@dataclass(frozen=True, slots=True)
class MalformedMessage:
    """One malformed message.

    Attributes:
        what: What is wrong with it.
        kind: Class of the message.
        topic: Its topic.
        message: The message, or its bytes.
    """

    what: str
    kind: type[Any]
    topic: str
    message: Any = field(repr=False)


def images(
    task: str, image: GreyImage, next_stamp: Callable[[], int]
) -> Iterator[tuple[MalformedMessage, MalformedMessage]]:
    """Yield malformed images in pairs of one stamp, so that each is decoded.

    Args:
        task: Whose images, `loc` or `nav`.
        image: A valid image.
        next_stamp: Returns the stamp of the next pair, nanoseconds.
    """
    height, width = image.shape
    data = image.tobytes()

    def pair(what: str, **changes: Any) -> tuple[MalformedMessage, MalformedMessage]:  # noqa: ANN401
        fields = {"height": height, "width": width, "encoding": "mono8", "step": width, "data": data} | changes
        message = Image(header=header_msg(next_stamp(), ""), **fields)
        left, right = (MalformedMessage(what, Image, f"{task}/{side}/image_rect", message) for side in SIDES)
        return left, right

    for step in (0, width - 1, 2 * width, HUGE):
        yield pair(f"step {step}", step=step)
    for size in ((1, 1), (0, 0), (65_535, 65_535), (HUGE, HUGE), (height // 2, width)):
        yield pair(f"size {size[1]} x {size[0]}", height=size[0], width=size[1])
    yield pair("4 GB with consistent step", height=65_536, width=65_536, step=65_536)
    for length in (0, 1, len(data) - 1, 2 * len(data)):
        yield pair(f"{length} bytes of data", data=bytes(length))
    for encoding in ("", "mono8 ", "yuv422", "bayer_rggb8", "32FC1", "64FC4", "mono16", "rgb8", "x" * 1_000_000):
        yield pair(f"encoding '{encoding[:12]}'", encoding=encoding)
    floats = np.full((height, width), NAN, "<f4")
    yield pair("32FC1 of NaN", encoding="32FC1", step=4 * width, data=floats.tobytes())
    for name, content in _compressed(width, height):
        message = CompressedImage(header=header_msg(next_stamp(), ""), format="png", data=content)
        left, right = (
            MalformedMessage(name, CompressedImage, f"{task}/{side}/image_rect/compressed", message) for side in SIDES
        )
        yield left, right


def _compressed(width: int, height: int) -> Iterator[tuple[str, bytes]]:
    for size in ((65_535, 65_535), (width, height)):
        claim = b"".join(number.to_bytes(4, "big") for number in size)
        header = PNG_MAGIC + (13).to_bytes(4, "big") + b"IHDR" + claim + b"\x08\x00\0\0\0"
        yield f"PNG that claims {size[0]} x {size[1]} and ends there", header + bytes(64)
    yield "JPEG that ends after its first bytes", b"\xff\xd8\xff\xe0\x00\x10JFIF"
    yield "zero-length compressed image", b""
    yield "compressed image of noise", np.random.default_rng(1).bytes(5000)


def malformed_bytes(task: str, pair: StereoPair, rig: StereoRig) -> Iterator[MalformedMessage]:
    """Yield serialised images and camera_info that are cut off or state wrong lengths; none is of zero length."""
    image = serialised(bag_messages.image(pair.stamp_ns, pair.left, task, "left"))
    info = serialised(bag_messages.camera_info(pair.stamp_ns, rig, task, "left"))
    noise = CDR_HEADER + np.random.default_rng(2).bytes(4000)
    for kind, last, raw in ((Image, "image_rect", image), (CameraInfo, "camera_info", info)):
        topic = f"{task}/left/{last}"
        for length in (4, 5, 12, 15, 40, len(raw) // 2, len(raw) - 1):
            yield MalformedMessage(f"cut off after {length} bytes", kind, topic, raw[:length])
        altered = bytearray(raw)
        altered[12:16] = b"\xff\xff\xff\xff"  # the length of frame_id
        yield MalformedMessage("a text of 4 GB", kind, topic, bytes(altered))
        yield MalformedMessage("noise", kind, topic, noise)
        yield MalformedMessage("another wire encoding", kind, topic, b"\xff\xff\xff\xff" + raw[4:])
    altered = bytearray(image)
    offset = len(image) - pair.left.size - 4
    altered[offset : offset + 4] = b"\xff\xff\xff\x7f"
    yield MalformedMessage("an image of 2 GB", Image, f"{task}/left/image_rect", bytes(altered))


def camera_infos(task: str, stamp_ns: int, rig: StereoRig) -> Iterator[tuple[MalformedMessage, MalformedMessage]]:
    """Yield camera_info in pairs of left and right."""

    def infos(what: str, **changes: Any) -> tuple[MalformedMessage, MalformedMessage]:  # noqa: ANN401
        made = []
        for side in SIDES:
            valid = bag_messages.camera_info(stamp_ns, rig, task, side)
            fields: dict[str, Any] = {
                "height": rig.height,
                "width": rig.width,
                "distortion_model": "plumb_bob",
                "d": np.zeros(5).tolist(),
                "k": np.asarray(valid.k, np.float64),
                "r": np.eye(3).reshape(-1),
                "p": np.asarray(valid.p, np.float64),
            } | changes
            message = CameraInfo(header=header_msg(stamp_ns, ""), **fields)
            made.append(MalformedMessage(what, CameraInfo, f"{task}/{side}/camera_info", message))
        return made[0], made[1]

    yield infos("k and p of NaN", k=np.full(9, NAN), p=np.full(12, NAN))
    yield infos("k and p of zero", k=np.zeros(9), p=np.zeros(12))
    yield infos("p of 1e308", p=np.full(12, 1e308))
    yield infos("4294967295 x 4294967295", width=HUGE, height=HUGE)
    yield infos("0 x 0", width=0, height=0)
    yield infos("a rotation of zero", r=np.zeros(9))
    yield infos("a million distortion coefficients", d=[0.1] * 1_000_000)


def invalid_poses() -> Iterator[tuple[str, Pose]]:
    """Yield invalid poses."""
    for what, xyz, quat in (
        ("position of NaN", (NAN, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)),
        ("position of infinity", (math.inf, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)),
        ("position of 1e300", (1e300, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)),
        ("quaternion of zero", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)),
        ("quaternion of NaN", (0.0, 0.0, 0.0), (NAN, 0.0, 0.0, 1.0)),
        ("quaternion of length 1e200", (0.0, 0.0, 0.0), (1e200, 0.0, 0.0, 0.0)),
    ):
        yield what, Pose(position=Point(**dict(zip("xyz", xyz, strict=True))), orientation=_quaternion(quat))


def _quaternion(values: tuple[float, ...]) -> Quaternion:
    return Quaternion(**dict(zip("xyzw", values, strict=True)))


def poses_for_localisation(stamp_ns: int) -> Iterator[MalformedMessage]:
    """Yield invalid initialpose and wheel odometry."""
    header = header_msg(stamp_ns, "")
    for what, pose in invalid_poses():
        start = PoseWithCovarianceStamped(header=header)
        start.pose.pose = pose
        yield MalformedMessage(what, PoseWithCovarianceStamped, "initialpose", start)
        wheels = Odometry(header=header, child_frame_id="rb")
        wheels.pose.pose = pose
        yield MalformedMessage(what, Odometry, "motion_prior", wheels)
    yield MalformedMessage(
        "another frame",
        PoseWithCovarianceStamped,
        "initialpose",
        PoseWithCovarianceStamped(header=header_msg(stamp_ns, "mars")),
    )


def poses_for_mapping(stamp_ns: int) -> Iterator[MalformedMessage]:
    """Yield invalid poses of navigation pairs."""
    for number, (what, pose) in enumerate(invalid_poses()):
        yield MalformedMessage(
            what, PoseStamped, "nav/pose", PoseStamped(header=header_msg(stamp_ns + number, "lm"), pose=pose)
        )


def messages_for_monitor(stamp_ns: int) -> Iterator[MalformedMessage]:
    """Yield malformed estimates, truth, calls, clouds and configurations."""
    for what, pose in invalid_poses():
        for topic in ("localisation/odometry", "ground_truth/odometry"):
            message = Odometry(header=header_msg(stamp_ns, "ds"), child_frame_id="rb")
            message.pose.pose = pose
            yield MalformedMessage(what, Odometry, topic, message)
    yield from _calls(stamp_ns)
    yield from _clouds(stamp_ns)
    for text in ("", "{", "[" * 100_000, "7", json.dumps({"x": "y" * 1_000_000})):
        yield MalformedMessage(f"configuration '{text[:3]}'", String, "localisation/configuration", String(data=text))


def _calls(stamp_ns: int) -> Iterator[MalformedMessage]:
    valid = {"task": "localisation", "stamp_ns": str(stamp_ns), "state": "tracking", "processing_time_s": "0.1"}
    for what, changes in (
        ("a time that is not a number", {"processing_time_s": "abc"}),
        ("a time of NaN", {"processing_time_s": "nan"}),
        ("a time of 1e400", {"processing_time_s": "1e400"}),
        ("a stamp of 5000 digits", {"stamp_ns": "9" * 5000}),
        ("a stamp of 30 digits", {"stamp_ns": "9" * 30}),
        ("memory of 30 digits", {"peak_rss_bytes": "9" * 30, "above_idle_bytes": "1"}),
        ("another task", {"task": "cooking"}),
        ("another state", {"state": "mapped"}),
        ("a figure that is not a number", {"statistic.x": "y"}),
    ):
        values = [KeyValue(key=key, value=value) for key, value in (valid | changes).items()]
        status = DiagnosticStatus(name="localisation_node: call", values=values, level=b"\x00")
        yield MalformedMessage(f"call with {what}", DiagnosticArray, "/diagnostics", DiagnosticArray(status=[status]))
    many = [DiagnosticStatus(name="x: call", level=b"\x09", values=[KeyValue(key="task")])] * 20_000
    yield MalformedMessage("20000 statuses", DiagnosticArray, "/diagnostics", DiagnosticArray(status=many))


def _clouds(stamp_ns: int) -> Iterator[MalformedMessage]:
    fields = [PointField(name=name, offset=4 * n, datatype=7, count=1) for n, name in enumerate("xyz")]
    for topic in ("mapping/points", "ground_truth/points"):
        for what, changes in (
            ("no fields", {"fields": []}),
            ("4294967295 x 4294967295 points", {"height": HUGE, "width": HUGE}),
            ("steps of zero", {"point_step": 0, "row_step": 0}),
            ("steps of 4 GB", {"point_step": HUGE, "row_step": HUGE}),
            ("no data", {"data": b""}),
            (
                "fields beyond the point",
                {"fields": [PointField(name=f.name, offset=HUGE - 3, datatype=7, count=1) for f in fields]},
            ),
        ):
            given: dict[str, Any] = {
                "height": 1,
                "width": 4,
                "fields": fields,
                "point_step": 12,
                "row_step": 48,
                "data": bytes(48),
            }
            message = PointCloud2(header=header_msg(stamp_ns, "lm"), **(given | changes))
            yield MalformedMessage(f"cloud with {what}", PointCloud2, topic, message)
