#!/usr/bin/env python3
"""A localiser as a ROS node, written without sfr_loc_map: stereo odometry of OpenCV's building blocks.

The node subscribes to loc/{left,right}/image_rect and loc/right/camera_info and publishes nav_msgs/Odometry on
localisation/odometry: the pose of the left optical frame (x right, y down, z forward) in the first left optical frame,
with the stamp of the images. It is an example and not tuned for accuracy. Test it beside the node of the suite:

    sfr replay data/ --external localisation --command "python3 examples/external_node.py" \
        --convention frame=left_optical --convention world=first_pose --out out/
"""

import json
import time

import cv2
import numpy as np
import rclpy
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import String

CORNERS, MIN_INLIERS = 800, 8


class ExternalOdometry(Node):
    """Pairs images by their stamps, and accumulates the motion from pair to pair."""

    def __init__(self) -> None:
        """Subscribe to the images and to the calibration of the right camera, which contains the baseline."""
        super().__init__("external_odometry")
        depth = QoSProfile(depth=10)
        self.images: dict[str, Image] = {}
        self.calibration = None
        self.previous = None
        self.pose = np.eye(4)
        self.create_subscription(CameraInfo, "loc/right/camera_info", self.on_calibration, depth)
        for side in ("left", "right"):
            self.create_subscription(Image, f"loc/{side}/image_rect", lambda m, s=side: self.on_image(s, m), depth)
        self.publisher = self.create_publisher(Odometry, "localisation/odometry", depth)
        self.calls = self.create_publisher(String, "localisation_node/call", depth)

    def on_calibration(self, message: CameraInfo) -> None:
        """Store the camera matrix, and the focal length times the baseline."""
        p = np.array(message.p).reshape(3, 4)
        self.calibration = p[:, :3], -p[0, 3]

    def on_image(self, side: str, message: Image) -> None:
        """Process a pair as soon as both images of a stamp were received."""
        self.images[side] = message
        stamps = {(image.header.stamp.sec, image.header.stamp.nanosec) for image in self.images.values()}
        if self.calibration is None or len(self.images) < 2 or len(stamps) > 1:
            return
        left, right = (
            np.frombuffer(self.images[s].data, np.uint8).reshape(message.height, -1)[:, : message.width]
            for s in ("left", "right")
        )
        begin = time.perf_counter()
        self.step(left, right)
        self.publish(message.header.stamp, time.perf_counter() - begin)

    def step(self, left: np.ndarray, right: np.ndarray) -> None:
        """Update the pose by the motion since the previous pair, if the motion can be estimated."""
        matrix, focal_baseline = self.calibration
        if self.previous is not None and len(self.previous[1]) >= MIN_INLIERS:
            image, corners, points = self.previous
            tracked, found, _ = cv2.calcOpticalFlowPyrLK(image, left, corners, None)
            good = found[:, 0] == 1
            if good.sum() >= MIN_INLIERS:
                solved, turn, shift, inliers = cv2.solvePnPRansac(
                    points[good], tracked[good], matrix, None, reprojectionError=1.0
                )
                if solved and inliers is not None and len(inliers) >= MIN_INLIERS:
                    now_before = np.eye(4)
                    now_before[:3, :3], now_before[:3, 3] = cv2.Rodrigues(turn)[0], shift[:, 0]
                    self.pose = self.pose @ np.linalg.inv(now_before)
        corners = cv2.goodFeaturesToTrack(left, CORNERS, 0.005, 6.0)
        if corners is None:
            self.previous = (left, np.zeros((0, 2), np.float32), np.zeros((0, 3)))
            return
        corners = corners.reshape(-1, 2)
        partners, found, _ = cv2.calcOpticalFlowPyrLK(left, right, corners, None)
        disparity = corners[:, 0] - partners[:, 0]
        good = (found[:, 0] == 1) & (np.abs(corners - partners)[:, 1] < 1.0) & (disparity > 0.5)
        corners, depth = corners[good], focal_baseline / disparity[good]
        rays = np.column_stack((corners, np.ones(len(corners)))) @ np.linalg.inv(matrix).T
        self.previous = (left, corners, rays * depth[:, None])

    def publish(self, stamp: object, seconds: float) -> None:
        """Publish the pose, and the duration of the call (which is optional)."""
        message = Odometry()
        message.header.stamp, message.header.frame_id, message.child_frame_id = stamp, "start", "camera"
        w, x, y, z = quaternion(self.pose[:3, :3])
        orientation, position = message.pose.pose.orientation, message.pose.pose.position
        orientation.w, orientation.x, orientation.y, orientation.z = w, x, y, z
        position.x, position.y, position.z = (float(value) for value in self.pose[:3, 3])
        stamp_ns = stamp.sec * 10**9 + stamp.nanosec
        call = {"stamp_ns": stamp_ns, "processing_time_s": seconds, "version": "1.0"}
        self.calls.publish(String(data=json.dumps(call)))
        self.publisher.publish(message)


def quaternion(rotation: np.ndarray) -> tuple[float, float, float, float]:
    """Return the quaternion w, x, y, z of a rotation matrix."""
    vector = cv2.Rodrigues(rotation)[0][:, 0]
    angle = float(np.linalg.norm(vector))
    axis = vector / angle if angle > 0 else vector
    x, y, z = (float(value) for value in np.sin(angle / 2) * axis)
    return float(np.cos(angle / 2)), x, y, z


def main() -> None:
    """Run the node until it is interrupted."""
    rclpy.init()
    node = ExternalOdometry()
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, rclpy.executors.ExternalShutdownException):
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
