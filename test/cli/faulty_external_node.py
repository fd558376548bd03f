"""The example of an external node with something wrong at some pairs; what it believes goes to standard output."""

import copy
import importlib.util
import json
import sys
from pathlib import Path
from typing import Any

import rclpy

EXAMPLE = Path(__file__).parents[2] / "examples" / "external_node.py"
SPEC = importlib.util.spec_from_file_location("external_node", EXAMPLE)
assert SPEC is not None
assert SPEC.loader is not None
example = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(example)

DOUBLED, NOT_FINITE, OTHER_FRAME, SILENT, CRASH = 2, 4, 5, 7, 12


class FaultyPublisher:
    """Publishes poses, each fault once."""

    def __init__(self, publisher: Any) -> None:
        self.publisher, self.count = publisher, 0

    def publish(self, message: Any) -> None:
        number, self.count = self.count, self.count + 1
        if number == CRASH:
            print("out of memory, as it were", flush=True)
            sys.exit(3)
        if number == SILENT:
            return
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
        p, q, stamp = message.pose.pose.position, message.pose.pose.orientation, message.header.stamp
        pose = [stamp.sec * 10**9 + stamp.nanosec, p.x, p.y, p.z, q.x, q.y, q.z, q.w]
        print(json.dumps({"pose": pose}), flush=True)


rclpy.init()
node = example.ExternalOdometry()
node.publisher = FaultyPublisher(node.publisher)
rclpy.spin(node)
