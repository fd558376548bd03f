"""A rover that publishes small stereo pictures at 10 Hz, with one thing wrong: `rover_process.py WHAT`."""

# ruff: noqa: E402 - the helpers beside the tests must be importable first
from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

for folder in ("scenes", "nodes"):
    sys.path.insert(0, str(Path(__file__).resolve().parents[1] / folder))

import numpy as np
import rclpy
from made_scene import LOC_RIG, loc_pair
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import String

from sfr_loc_map.io import bag_messages
from sfr_loc_map.io.bag import TYPESTORE

PERIOD_S = 0.1


def main(what: str) -> None:
    rclpy.init(args=[])
    node = rclpy.create_node("rover")
    reliable = QoSProfile(depth=10)
    best_effort = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
    kinds: dict[str, Any] = {"ground_truth/odometry": Odometry}
    for side in ("left", "right"):
        kinds |= {f"loc/{side}/image_rect": Image, f"loc/{side}/camera_info": CameraInfo}
    if what == "wrong type":
        kinds["loc/right/image_rect"] = String
    left_out = "loc/right/image_rect" if what == "no publisher" else ""
    publishers = {
        name: node.create_publisher(kind, name, best_effort if what == "qos" and "image" in name else reliable)
        for name, kind in kinds.items()
        if name != left_out
    }
    pairs = [loc_pair(index) for index in range(8)]
    print("ready", flush=True)
    turn = 0
    while True:
        pair = pairs[turn % len(pairs)]
        stamp_ns = time.time_ns() - 3_600_000_000_000 * (what == "clocks apart")
        messages: dict[str, Any] = {}
        for side, picture in (("left", pair.left), ("right", pair.right)):
            at_ns = stamp_ns + 3_000_000 * (what == "unsynchronised" and side == "right")
            messages[f"loc/{side}/image_rect"] = bag_messages.image(at_ns, picture, "loc", side)
            messages[f"loc/{side}/camera_info"] = bag_messages.camera_info(at_ns, LOC_RIG, "loc", side)
        messages["ground_truth/odometry"] = bag_messages.odometry(stamp_ns, np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
        for name, publisher in publishers.items():
            if what == "silent" and name == "loc/right/image_rect":
                continue
            if publisher.msg_type is String:
                publisher.publish(String(data="picture"))
                continue
            message = messages[name]
            publisher.publish(bytes(TYPESTORE.serialize_cdr(message, message.__msgtype__)))
        turn += 1
        time.sleep(PERIOD_S)


if __name__ == "__main__":
    main(sys.argv[1])
