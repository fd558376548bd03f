"""The example of an external node, with faulty answers to some pairs."""

import copy
import importlib.util
import sys
from pathlib import Path
from typing import Any

import rclpy
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import PointCloud2

EXAMPLE = Path(__file__).parents[2] / "examples" / "external_node.py"
SPEC = importlib.util.spec_from_file_location("external_node", EXAMPLE)
assert SPEC is not None
assert SPEC.loader is not None
example = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(example)

DOUBLED, NOT_FINITE, OTHER_FRAME, CRASH = 2, 4, 5, 11


class FaultyPublisher:
    """Publishes poses, each fault once."""

    def __init__(self, publisher: Any) -> None:
        self.publisher, self.count = publisher, 0

    def publish(self, message: Any) -> None:
        number, self.count = self.count, self.count + 1
        if number == CRASH:
            print("out of memory, as it were", flush=True)
            sys.exit(3)
        wrong = copy.deepcopy(message)
        if number == NOT_FINITE:
            wrong.pose.pose.position.x = float("nan")
        if number == OTHER_FRAME:
            wrong.child_frame_id = "imu"
        if number in (NOT_FINITE, OTHER_FRAME):
            self.publisher.publish(wrong)
            return
        self.publisher.publish(message)
        if number == DOUBLED:
            self.publisher.publish(message)


rclpy.init()
node = example.ExternalOdometry()
node.publisher = FaultyPublisher(node.publisher)
latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)  # as no replay publishes it
node.create_subscription(PoseWithCovarianceStamped, "initialpose", print, latched)
for topic, kind in (("ground_truth/odometry", Odometry), ("ground_truth/points", PointCloud2)):
    node.create_subscription(kind, topic, lambda message: print("the truth is here", flush=True), QoSProfile(depth=10))
rclpy.spin(node)
