"""A localisation node that is stationary and misbehaves: `python misbehaving_node.py HOW`."""

from __future__ import annotations

import os
import signal
import sys
import time

import rclpy
from nav_msgs.msg import Odometry
from rclpy.node import Node
from sensor_msgs.msg import Image

PAIRS, PERIOD_NS = 12, 100_000_000  #: Of the drive, which a node that answers early knows.


class Misbehaving(Node):
    def __init__(self, how: str) -> None:
        super().__init__("misbehaving")
        self.how, self.count = how, 0
        self.publisher = self.create_publisher(Odometry, "localisation/odometry", 10)
        self.create_subscription(Image, "loc/left/image_rect", lambda message: None, 10)
        self.create_subscription(Image, "loc/right/image_rect", self.answer, 10)  # the last image of a pair

    def answer(self, message: Image) -> None:
        self.count += 1
        if (self.how == "dies" and self.count == 25) or (self.how == "restarts" and self.count == 8):
            os._exit(3)
        if self.how == "hangs" or (self.how == "leaves out" and self.count % 3 == 0):
            return
        if self.how == "late" and self.count == 5:
            time.sleep(1.3)
        if self.how == "early" and self.count == PAIRS:
            return
        out = Odometry()
        out.header, out.child_frame_id = message.header, "rb"
        out.header.frame_id = "ds"
        out.header.stamp.nanosec += 7 if self.how == "other stamps" else 0
        out.pose.pose.orientation.w = 1.0 if self.how != "not finite" else float("nan")
        for _ in range(2 if self.how == "doubled" else 1):
            if self.how != "early" or self.count == 1:
                self.publisher.publish(out)
        if self.how == "early":  # the answer to the pair that comes next
            next_ns = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec + PERIOD_NS
            out.header.stamp.sec, out.header.stamp.nanosec = divmod(next_ns, 10**9)
            self.publisher.publish(out)


def fork_twice() -> bytes:
    """Go on in a process of another session whose parent has ended, with 400 MB; the first process waits."""
    if os.fork():
        signal.pause()
    os.setsid()
    if os.fork():
        os._exit(0)
    return b"x" * 400_000_000


ballast = fork_twice() if sys.argv[1] == "forks" else b""
rclpy.init()
rclpy.spin(Misbehaving(sys.argv[1]))
