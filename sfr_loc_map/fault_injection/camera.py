"""A process that publishes the images of the localisation cameras until it is killed: camera.py RATE_HZ."""

from __future__ import annotations

import sys
import time

import rclpy
from rclpy.qos import QoSProfile
from rclpy.utilities import ok
from sensor_msgs.msg import CameraInfo, Image

from sfr_loc_map.fault_injection.fake_rover import IMAGE_DEPTH, serialised
from sfr_loc_map.fault_injection.scene import Scene
from sfr_loc_map.inputs import SIDES
from sfr_loc_map.io import bag_messages
from sfr_loc_map.nodes import environment
from sfr_loc_map.nodes.environment import start_ros


def main() -> None:
    """Publish."""
    environment.prepare()
    rate_hz, scene = float(sys.argv[1]), Scene()
    start_ros(signals=True)
    node = rclpy.create_node("sfr_camera")
    qos = QoSProfile(depth=IMAGE_DEPTH)
    images = [node.create_publisher(Image, f"loc/{side}/image_rect", qos) for side in SIDES]
    infos = [node.create_publisher(CameraInfo, f"loc/{side}/camera_info", qos) for side in SIDES]
    due, index = time.monotonic(), 0
    while ok():
        stamp_ns = time.time_ns()
        pair = scene.loc_pair(index, stamp_ns)
        for publisher, side, pixels in zip(images, SIDES, (pair.left, pair.right), strict=True):
            publisher.publish(serialised(bag_messages.image(stamp_ns, pixels, "loc", side)))
        for publisher, side in zip(infos, SIDES, strict=True):
            publisher.publish(serialised(bag_messages.camera_info(stamp_ns, scene.loc, "loc", side)))
        index += 1
        due += 1.0 / rate_hz
        time.sleep(max(due - time.monotonic(), 0.0))


if __name__ == "__main__":
    main()
