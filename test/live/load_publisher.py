"""Publishes stereo images of 1 MP at 10 Hz with poses, and a cloud of a million points each 5 s."""

from __future__ import annotations

import time

import numpy as np
import rclpy
from nav_msgs.msg import Odometry
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import Image, PointCloud2

from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.nodes import environment
from sfr_loc_map.nodes.messages.fields import byte_array, header_msg
from sfr_loc_map.nodes.messages.point_cloud import cloud_msg

WIDTH, HEIGHT, POINTS = 1152, 896, 1_000_000
RATE_HZ, CLOUD_PERIOD_S = 10.0, 5.0


def publish_load(seconds: float) -> int:
    """Publish for some time; return how many poses."""
    environment.prepare()
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("load_publisher")
    qos = QoSProfile(depth=5)
    images = [node.create_publisher(Image, f"loc/{side}/image_rect", qos) for side in ("left", "right")]
    odometry = node.create_publisher(Odometry, "localisation/odometry", qos)
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    clouds = node.create_publisher(PointCloud2, "mapping/points", latched)
    records = np.zeros(POINTS, PointCloud.dtype())
    rng = np.random.default_rng(1)
    for name in "xyz":
        records[name] = rng.uniform(-5.0, 5.0, POINTS)
    cloud = PointCloud.from_structured(records)
    pixels = byte_array(rng.integers(0, 255, (HEIGHT, WIDTH), np.uint8))
    time.sleep(2.0)  # discovery
    begin, sent, next_cloud = time.monotonic(), 0, 0.0
    while (now := time.monotonic() - begin) < seconds:
        stamp_ns = time.time_ns()
        header = header_msg(stamp_ns, "ds")
        image = Image(header=header, height=HEIGHT, width=WIDTH, encoding="mono8", step=WIDTH, data=pixels)
        for publisher in images:
            publisher.publish(image)
        message = Odometry(header=header, child_frame_id="rb")
        message.pose.pose.position.x = 0.01 * sent
        odometry.publish(message)
        sent += 1
        if now >= next_cloud:
            clouds.publish(cloud_msg(cloud, stamp_ns, "lm"))
            next_cloud += CLOUD_PERIOD_S
        time.sleep(max(begin + sent / RATE_HZ - time.monotonic(), 0.0))
    time.sleep(1.0)
    node.destroy_node()
    rclpy.try_shutdown()
    return sent
