"""Rovers that publish small stereo images at 10 Hz, each with one fault: `-m helpers.rover_process WHAT[@DOMAIN]`."""

from __future__ import annotations

import itertools
import sys
import time
from typing import Any

import numpy as np
import rclpy
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import String

from helpers.made_scene import LOC_RIG, loc_pair
from sfr_loc_map.geometry.stereo import StereoPair
from sfr_loc_map.io.bag import messages as bag_messages
from sfr_loc_map.io.bag.encoding import TYPESTORE

PERIOD_S = 0.1


class Rover:
    """A rover with one thing wrong, in a ROS domain of its own."""

    def __init__(self, what: str, domain: int | None) -> None:
        self.what = what
        self.context = rclpy.Context()
        rclpy.init(args=[], context=self.context, domain_id=domain)
        node = rclpy.create_node("rover", context=self.context)
        kinds: dict[str, Any] = {"ground_truth/odometry": Odometry}
        for side in ("left", "right"):
            kinds |= {f"loc/{side}/image_rect": Image, f"loc/{side}/camera_info": CameraInfo}
        if what == "wrong type":
            kinds["loc/right/image_rect"] = String
        left_out = "loc/right/image_rect" if what == "no publisher" else ""
        self.publishers = {
            name: node.create_publisher(kind, name, QoSProfile(depth=10))
            for name, kind in kinds.items()
            if name != left_out
        }

    def publish(self, pair: StereoPair) -> None:
        stamp_ns = time.time_ns() - 3_600_000_000_000 * (self.what == "clocks apart")
        messages: dict[str, Any] = {}
        for side, pixels in (("left", pair.left), ("right", pair.right)):
            messages[f"loc/{side}/image_rect"] = bag_messages.image(stamp_ns, pixels, "loc", side)
            messages[f"loc/{side}/camera_info"] = bag_messages.camera_info(stamp_ns, LOC_RIG, "loc", side)
        messages["ground_truth/odometry"] = bag_messages.odometry(stamp_ns, np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
        for name, publisher in self.publishers.items():
            if publisher.msg_type is String:
                publisher.publish(String(data="no image"))
                continue
            message = messages[name]
            publisher.publish(bytes(TYPESTORE.serialize_cdr(message, message.__msgtype__)))


def main(words: list[str]) -> None:
    """Run a rover for each word, which names its fault, or its fault and its domain as FAULT@DOMAIN."""
    parts = [word.partition("@") for word in words]
    rovers = [Rover(what, int(domain) if domain else None) for what, _, domain in parts]
    pairs = [loc_pair(index) for index in range(8)]
    print("ready", flush=True)
    for turn in itertools.count():
        for rover in rovers:
            rover.publish(pairs[turn % len(pairs)])
        time.sleep(PERIOD_S)


if __name__ == "__main__":
    main(sys.argv[1:])
