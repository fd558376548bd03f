"""A process that publishes one camera of a pair like a driver, with its own clock, encoding and frame names.

python -m campaigns.camera_driver SETTINGS.json    prints `ready` once subscribed to; starts at a time read from stdin
"""

from __future__ import annotations

import json
import random
import sys
import time
from array import array
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import rclpy
from geometry_msgs.msg import Quaternion, TransformStamped, Vector3
from geometry_msgs.msg import Transform as TransformMsg
from numpy.typing import NDArray
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, Image

from helpers.node_scenes import DRIVERS, OPTICAL
from sfr_loc_map.nodes.localisation.extrinsics import TF_STATIC
from sfr_loc_map.ros.environment import start_ros
from sfr_loc_map.ros.messages import header_msg, tf_message_type

Pixels = NDArray[np.uint8]
ENCODINGS: dict[str, tuple[int, Callable[[Pixels], NDArray[Any]]]] = {
    "mono8": (1, lambda grey: grey),
    "bgr8": (3, lambda grey: cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)),
    "bayer_rggb8": (1, lambda grey: grey),
    "yuv422_yuy2": (2, lambda grey: np.dstack([grey, np.full_like(grey, 128)])),
    "mono16": (2, lambda grey: grey.astype(np.uint16) << 8),
}
"""Bytes per pixel, and the conversion from grey."""


def add_frames(node: Any, driver: str) -> Any:
    """Publish the frames from the rover's body to the left camera, latched."""
    kind = tf_message_type()
    if kind is None:
        return None
    chain = ("base_link", *DRIVERS[driver])
    message = kind()
    for parent, child in pairwise(chain):
        x, y, z, w = OPTICAL if child == chain[-1] else (0.0, 0.0, 0.0, 1.0)
        turn = TransformMsg(translation=Vector3(), rotation=Quaternion(x=x, y=y, z=z, w=w))
        message.transforms.append(TransformStamped(header=header_msg(0, parent), child_frame_id=child, transform=turn))
    publisher = node.create_publisher(kind, "/tf_static", TF_STATIC)
    publisher.publish(message)
    return publisher


def drive(settings: dict[str, Any]) -> dict[str, Any]:
    """Publish all images at their times; return the stamps and the delays."""
    start_ros()
    driver, side, count = settings["driver"], settings["side"], settings["count"]
    node = rclpy.create_node(f"{side}_camera")
    images = np.load(settings["images"], mmap_mode="r")[:count]
    height, width = images.shape[1:]
    per_pixel, convert = ENCODINGS[settings["encoding"]]
    publisher = node.create_publisher(Image, settings["topic"], qos_profile_sensor_data)
    infos = node.create_publisher(CameraInfo, settings["info_topic"], qos_profile_sensor_data)
    frames = add_frames(node, driver) if side == "left" else None
    while not (publisher.get_subscription_count() and infos.get_subscription_count()):
        time.sleep(0.02)
    print("ready", flush=True)
    begin_ns, rng, stamps, late = int(sys.stdin.readline()), random.Random(side), [], []
    frame = DRIVERS[driver][-1] if side == "left" else DRIVERS[driver][-1].replace("left", "right").replace("1", "2")
    info = CameraInfo(height=height, width=width, distortion_model="plumb_bob", **settings["camera"])
    for index in range(count):
        data = array("B")
        data.frombytes(memoryview(np.ascontiguousarray(convert(images[index]))).cast("B"))
        stamp_ns = begin_ns + round(1e9 * (index / settings["rate_hz"] + rng.uniform(0.0, settings["jitter_s"])))
        time.sleep(max(0.0, 1e-9 * (stamp_ns - time.time_ns())))
        late.append(1e-9 * (time.time_ns() - stamp_ns))
        header = header_msg(stamp_ns, frame)
        info.header = header
        infos.publish(info)
        message = Image(header=header, height=height, width=width, encoding=settings["encoding"])
        message.step, message.data = width * per_pixel, data
        publisher.publish(message)
        stamps.append(stamp_ns)
    time.sleep(1.0)  # the last messages are still in transit
    del frames
    return {"stamps_ns": stamps, "late_s": late}


if __name__ == "__main__":
    print(json.dumps(drive(json.loads(Path(sys.argv[1]).read_text()))), flush=True)
