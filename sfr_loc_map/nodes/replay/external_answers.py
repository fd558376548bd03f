"""What an external node publishes: read leniently, kept as it is, converted for the monitor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import PointCloud2

from sfr_loc_map.errors import GeometryError, InputError, MetricsError
from sfr_loc_map.geometry.pose_convention import FIRST_POSE, PoseConvention, aligned, converted
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.image_codec import stamp_of
from sfr_loc_map.metrics.association import Estimates
from sfr_loc_map.metrics.convention import world_at_first_pose
from sfr_loc_map.nodes.messages.fields import header_msg
from sfr_loc_map.nodes.messages.point_cloud import cloud_from_msg, cloud_msg, points_from_msg
from sfr_loc_map.nodes.messages.pose import covariance_of, odometry_row, pose_msg
from sfr_loc_map.nodes.replay.external_options import ExternalOptions
from sfr_loc_map.nodes.replay.results import ReplayResults
from sfr_loc_map.pipeline.external_run import Answer

DEPTH = 1000
WORLD, BODY, MAP = "ds", "rb", "lm"


class OdometryAnswers:
    """Poses of an external localiser."""

    kind = Odometry

    def __init__(self, node: Node, options: ExternalOptions, rig: StereoRig | None, truth: Trajectory | None) -> None:
        """Advertise the converted poses.

        Args:
            node: Joins the graph.
            options: What is known of the node under test.
            rig: Rig of the source.
            truth: True poses of the source.

        Raises:
            ConfigError: If its frame follows from a rig that is not known.
        """
        self._convention, self._truth = options.convention, truth
        self._T_rb_child = options.convention.T_rb_child(rig)
        self._T_ds_world: Transform | None = None
        self._publisher = node.create_publisher(Odometry, options.converted_topic, QoSProfile(depth=DEPTH))

    def begin_run(self) -> None:
        """Forget the world frame of the run before."""
        self._T_ds_world = None

    def read(self, message: Odometry) -> Answer:
        """Return stamp, frames and problem of a pose."""
        frames = f"{message.header.frame_id} -> {message.child_frame_id}"
        try:
            odometry_row(message)
        except InputError as error:
            return Answer(stamp_of(message), frames, str(error))
        return Answer(stamp_of(message), frames)

    def keep(self, message: Odometry, results: ReplayResults) -> None:
        """Keep a pose as it was published, and publish it converted."""
        row = odometry_row(message)
        results.rows.append(row)
        covariance = covariance_of(message)
        if np.isfinite(covariance).all() and covariance.any():
            results.covariances[row[0]] = covariance
        try:
            poses = Trajectory(np.array([row[0]], np.int64), np.array([row[1]]), np.array([row[2]]))
            poses = converted(poses, self._convention, self._T_rb_child)
            if self._convention.world == FIRST_POSE:
                if self._T_ds_world is None:
                    self._T_ds_world = world_at_first_pose(Estimates.of(poses), self._truth)
                poses = aligned(poses, self._T_ds_world)
        except (GeometryError, MetricsError):
            return  # nothing for the monitor; the score tells why
        stamp_ns = max(int(poses.stamps_ns[0]), 0)
        out = Odometry(header=header_msg(stamp_ns, WORLD), child_frame_id=BODY)
        out.pose.pose = pose_msg(poses.pose(0), poses.quats_xyzw[0])
        self._publisher.publish(out)


class CloudAnswers:
    """Clouds of an external mapper; points alone, or with all fields of `mapping/points`."""

    kind = PointCloud2

    def __init__(self, node: Node, options: ExternalOptions, rig: StereoRig, poses: Mapping[int, Transform]) -> None:
        """Advertise the converted clouds.

        Args:
            node: Joins the graph.
            options: What is known of the node under test.
            rig: Rig of the source.
            poses: `T_lm_navsb` of the pairs by stamp.

        Raises:
            ConfigError: If what is declared is no frame of the rig.
        """
        convention, here = options.convention, replace(rig, T_rb_sb=Transform.identity())
        self._in_lm = convention == PoseConvention(metres_per_unit=convention.metres_per_unit)
        self._unit, self._poses = convention.metres_per_unit, poses
        self._T_sb_child = convention.T_rb_child(here)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._publisher = node.create_publisher(PointCloud2, options.converted_topic, latched)

    def begin_run(self) -> None:
        """Nothing is kept from run to run."""

    def read(self, message: PointCloud2) -> Answer:
        """Return stamp, frame and problem of a cloud."""
        stamp_ns, frame = stamp_of(message), message.header.frame_id
        try:
            points_from_msg(message)
        except InputError as error:
            return Answer(stamp_ns, frame, str(error))
        if not self._in_lm and stamp_ns not in self._poses:
            return Answer(stamp_ns, frame, "it has the stamp of no pair, whose pose would take its points to LM")
        return Answer(stamp_ns, frame)

    def keep(self, message: PointCloud2, results: ReplayResults) -> None:
        """Keep a cloud in LM, and publish it if it has all fields."""
        stamp_ns = stamp_of(message)
        points = self._to_lm(points_from_msg(message), stamp_ns)
        results.points.append((stamp_ns, points[np.isfinite(points).all(axis=1)]))
        try:
            cloud = cloud_from_msg(message)
        except InputError:
            return  # points without pixels: they are scored by the nearest true point
        cloud = replace(cloud, xyz=points.astype(np.float32))
        results.clouds.append((stamp_ns, cloud))
        self._publisher.publish(cloud_msg(cloud, stamp_ns, MAP))

    def _to_lm(self, points: np.ndarray, stamp_ns: int) -> np.ndarray:
        points = points * self._unit
        return points if self._in_lm else (self._poses[stamp_ns] @ self._T_sb_child).apply(points)
