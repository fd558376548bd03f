"""Read the answers of an external node leniently, and publish them converted for the monitor and the page.

Poses are stored as published and converted twice. During the replay each pose is converted for the monitor and the
page, by the declared convention. After the replay all poses are converted for the score (`external_poses`), because a
diagnosis of the convention requires all poses. Clouds are converted once, when received: points are stored in LM.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Protocol

import numpy as np
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile
from sensor_msgs.msg import PointCloud2

from sfr_loc_map.errors import ConfigError, GeometryError, InputError, MetricsError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.sequence import LocSequence, NavSequence, Source
from sfr_loc_map.message_stamps import stamp_of
from sfr_loc_map.methods.method_call import MethodFailureError
from sfr_loc_map.methods.point_bounds import check_points
from sfr_loc_map.metrics.conventions.pose_convention import (
    FIRST_POSE,
    PoseConvention,
    aligned_estimates,
    converted_estimates,
    world_at_first_pose,
)
from sfr_loc_map.metrics.figures.records import FindingKind
from sfr_loc_map.metrics.frames.association import Estimates
from sfr_loc_map.metrics.frames.covariance import UPPER, symmetric
from sfr_loc_map.replay.message_store import Received, ReceivedCloud, ReceivedDrive, ReceivedMaps
from sfr_loc_map.replay.options import ExternalOptions
from sfr_loc_map.replay.replay_peer import ReplayPeer
from sfr_loc_map.ros.messages import header_msg
from sfr_loc_map.ros.point_messages import cloud_from_msg, cloud_msg, xyz_from_msg
from sfr_loc_map.ros.pose_messages import OdometryRow, covariance_of, odometry_row, pose_msg
from sfr_loc_map.ros.qos import LATCHED
from sfr_loc_map.suite_names import Task

DEPTH = 1000  #: Queue depth of answers and of converted poses, one per pair: no answer may be lost.
WORLD, BODY, MAP = "ds", "rb", "lm"  #: Frames of the converted messages, as the nodes of the suite name them.


class AnswerConverter(Protocol):
    """Reads the answers of one type of external node, stores them and publishes them converted."""

    kind: type[Any]  #: Type of the messages.

    def frames_of(self, message: Any) -> str:  # noqa: ANN401 - of `kind`
        """Return the frame ids of a message: `parent` or `parent -> child`."""

    def read(self, message: Any) -> Any:  # noqa: ANN401 - of `kind`
        """Return the content of a message; raise a MethodFailureError if the message is not a valid result."""

    def accept(self, message: Any, content: Any) -> None:  # noqa: ANN401 - of `kind`
        """Add the content of a message to the results, and publish the converted message."""


class PoseConverter:
    """Converts the poses of an external localiser."""

    kind = Odometry

    def __init__(self, peer: ReplayPeer, options: ExternalOptions, received: ReceivedDrive, loc: LocSequence) -> None:
        """Create the publisher of converted poses. The convention may require the rig and the ground truth."""
        self._received = received
        self._convention = options.convention
        self._truth = loc.ground_truth
        self._in_own_world = replace(options.convention, world="ds")
        self._T_rb_child = options.convention.T_rb_child(loc.rig)
        # pose with the earliest stamp, because a convention may state poses relative to this pose
        self._first: OdometryRow | None = None
        self._T_ds_world: Transform | None = None  # of the first pose, if the convention aligns the world with it
        self._publisher = peer.ros_node.create_publisher(Odometry, options.converted_topic, QoSProfile(depth=DEPTH))

    def frames_of(self, message: Odometry) -> str:
        """Return the frames of a pose."""
        return f"{message.header.frame_id} -> {message.child_frame_id}"

    def read(self, message: Odometry) -> OdometryRow:
        """Return stamp, position and quaternion; raise a MethodFailureError if the pose is invalid."""
        try:
            return odometry_row(message)
        except InputError as error:
            p, q = message.pose.pose.position, message.pose.pose.orientation
            is_finite = bool(np.isfinite((p.x, p.y, p.z, q.x, q.y, q.z, q.w)).all())
            kind = FindingKind.INVALID_RESULT if is_finite else FindingKind.NOT_FINITE
            raise MethodFailureError(kind, str(error)) from error

    def accept(self, message: Odometry, row: OdometryRow) -> None:
        """Add a pose as published, and publish the converted pose."""
        covariance = covariance_of(message)
        self._received.add_pose(row, covariance)
        try:
            estimates = self._converted(row, covariance)
        except (GeometryError, MetricsError):
            return  # the pose cannot be converted; the score reports the reason
        poses = estimates.trajectory
        out = Odometry(header=header_msg(max(int(poses.stamps_ns[0]), 0), WORLD), child_frame_id=BODY)
        out.pose.pose = pose_msg(poses.pose(0), poses.quats_xyzw[0])
        if estimates.covariance is not None:
            out.pose.covariance = symmetric(estimates.covariance[0]).reshape(36)
        self._publisher.publish(out)

    def _converted(self, row: OdometryRow, covariance: FloatArray) -> Estimates:
        """Return a pose with its covariance `(6, 6)` as a pose of RB in DS.

        The pose is converted together with the first pose, because a convention may state poses relative to the first
        pose.
        """
        if self._first is None or row[0] < self._first[0]:
            self._first = row
        rows = (self._first, row)
        poses = Trajectory(
            np.array([stamp_ns for stamp_ns, _, _ in rows], np.int64),
            np.array([position for _, position, _ in rows]),
            np.array([quat for _, _, quat in rows]),
        )
        published = Estimates.of(poses, covariance=np.array([covariance[UPPER]] * 2))
        both = converted_estimates(published, self._in_own_world, self._T_rb_child, None)
        estimates = both.at_rows(np.array([1]))
        if self._convention.world != FIRST_POSE:
            return estimates
        if self._T_ds_world is None:
            self._T_ds_world = world_at_first_pose(estimates, self._truth)
        return aligned_estimates(estimates, self._T_ds_world)


class CloudConverter:
    """Converts the clouds of an external mapper, which have only points or all fields of `mapping/points`."""

    kind = PointCloud2

    def __init__(self, peer: ReplayPeer, options: ExternalOptions, received: ReceivedMaps, nav: NavSequence) -> None:
        """Create the publisher of converted clouds, whose points are transformed to LM by the poses of the pairs."""
        self._received = received
        convention = options.convention
        self._unit = convention.metres_per_unit
        self._is_in_lm = convention == PoseConvention(metres_per_unit=self._unit)
        # If RB is the rig SB, `T_rb_child` is the transform from the frame of the points to SB.
        self._T_sb_child = convention.T_rb_child(replace(nav.rig, T_rb_sb=Transform.identity()))
        self._poses = {item.pair.stamp_ns: item.T_lm_navsb for item in nav.pairs()}
        self._shape = len(nav.stamps_ns), nav.rig.height, nav.rig.width
        self._publisher = peer.ros_node.create_publisher(PointCloud2, options.converted_topic, LATCHED)

    def frames_of(self, message: PointCloud2) -> str:
        """Return the frame of a cloud."""
        return str(message.header.frame_id)

    def read(self, message: PointCloud2) -> ReceivedCloud:
        """Return the cloud with points in the frame of the message, m, which `accept` converts.

        MethodFailureError if a point has a pixel or pair that the source does not have. The pixels of points that are
        not finite are not checked, because such points are not scored.
        """
        stamp_ns = stamp_of(message)
        try:
            points = xyz_from_msg(message) * self._unit
        except InputError as error:
            raise MethodFailureError(FindingKind.INVALID_RESULT, str(error)) from error
        try:
            cloud = cloud_from_msg(message)
        except InputError:  # points without pixels are scored against the nearest true point
            return ReceivedCloud(stamp_ns, points, None)
        finite = np.asarray(np.isfinite(points).all(axis=1))
        try:
            check_points(cloud.u[finite], cloud.v[finite], cloud.pair[finite], self._shape)
        except ValueError as error:
            raise MethodFailureError(FindingKind.INVALID_RESULT, str(error)) from error
        return ReceivedCloud(stamp_ns, points, cloud)

    def accept(self, message: PointCloud2, content: ReceivedCloud) -> None:
        """Convert the points of a pair to LM and add them; publish the finite points if the cloud has all fields.

        Points that are not finite are kept for the score, which counts them. In an organised cloud, such points are
        normal and are therefore omitted.
        """
        stamp_ns, points, cloud = content
        if not self._is_in_lm:
            points = (self._poses[stamp_ns] @ self._T_sb_child).apply(points)
        finite = np.asarray(np.isfinite(points).all(axis=1))
        kept = finite if message.height > 1 else np.ones_like(finite)
        if cloud is None:
            self._received.add_cloud(ReceivedCloud(stamp_ns, points[kept], None))
            return
        sigma = (cloud.sigma * self._unit).astype(np.float32)
        cloud = replace(cloud, xyz=points.astype(np.float32), sigma=sigma)
        self._received.add_cloud(ReceivedCloud(stamp_ns, points[kept], cloud.select(kept)))
        self._publisher.publish(cloud_msg(cloud.select(finite), stamp_ns, MAP))


def answer_converter(peer: ReplayPeer, source: Source, options: ExternalOptions, received: Received) -> AnswerConverter:
    """Return the converter of the answers of an external node, which adds them to `received`."""
    if options.task is Task.LOCALISATION and source.loc is not None:
        return PoseConverter(peer, options, received.drive, source.loc)
    if options.task is Task.MAPPING and source.nav is not None:
        return CloudConverter(peer, options, received.maps, source.nav)
    raise ConfigError(
        f"'--external {options.task}': the source has no pairs for this task; give a source that has them"
    )
