"""The localisation node, which estimates odometry from stereo pairs.

Messages are received in the executor's thread and passed in order to the worker. Only the worker's thread accesses the
session, so that a new rig, pose or configuration takes effect in order with the pairs.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMsg
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Image, PointCloud2
from std_msgs.msg import Header

from sfr_loc_map.calls.call_record import CallRecord, call_of_estimate
from sfr_loc_map.configuration.parameters import param
from sfr_loc_map.geometry.extrinsics import RB_FRAME
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.source_config import ExtrinsicsConfig
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.estimate import PoseEstimate, StartPose, TrackingState
from sfr_loc_map.localisation.frontend.masks import read_mask
from sfr_loc_map.localisation.localiser import Localiser
from sfr_loc_map.localisation.visualisation import draw_tracks
from sfr_loc_map.message_stamps import NS_PER_S, stamp_of
from sfr_loc_map.message_types import Level
from sfr_loc_map.nodes.lifecycle.runner import run
from sfr_loc_map.nodes.localisation.extrinsics import Extrinsics
from sfr_loc_map.nodes.localisation.localisation_session import LocalisationSession
from sfr_loc_map.nodes.localisation.odometry_buffer import OdometryBuffer
from sfr_loc_map.nodes.localisation.pose_file import PoseFile
from sfr_loc_map.nodes.localisation.thinned_path import ThinnedPath
from sfr_loc_map.nodes.pair_node import PairNode, PairNodeConfig, decoded
from sfr_loc_map.nodes.stereo.stereo_input import ReceivedPair
from sfr_loc_map.ros.image_messages import image_msg
from sfr_loc_map.ros.messages import header_msg, tf_message_type
from sfr_loc_map.ros.point_messages import TRACK_FIELDS, float_points_msg
from sfr_loc_map.ros.pose_messages import odometry_msg, start_pose_of, transform_from_pose, transform_msg
from sfr_loc_map.ros.qos import profile
from sfr_loc_map.suite_names import Task
from sfr_loc_map.topics import (
    DEBUG_IMAGE,
    ESTIMATE,
    ESTIMATED_PATH,
    INITIAL_POSE,
    INITIAL_POSE_SET,
    MOTION_PRIOR,
    TF,
    TRACKS,
)

MAX_POSE_AGE_NS = 600 * NS_PER_S
"""Maximum age of an initialpose relative to the last pair. Older poses apply only to later runs."""
ODOMETRY_DEPTH = 1000  #: Number of odometry messages kept for a slow subscriber.
LEVELS = {
    TrackingState.INITIALISING: Level.WARN,
    TrackingState.TRACKING: Level.OK,
    TrackingState.DEGRADED: Level.WARN,
    TrackingState.LOST: Level.ERROR,
}


@dataclass(frozen=True, slots=True)
class MotionPriorConfig:
    """How odometry on the topic motion_prior is used."""

    wait_s: float = param(
        0.0,
        unit="s",
        doc="Maximum time that a pair waits for odometry at or after its stamp, if any odometry was received before. "
        "0: no wait.",
        low=0.0,
        high=10.0,
    )


@dataclass(frozen=True, slots=True)
class LocalisationNodeConfig(PairNodeConfig):
    """Parameters of the localisation node."""

    ds_frame: str = param("ds", doc="Name of the world frame DS: parent of the odometry.")
    rb_frame: str = param(RB_FRAME, doc="Name of the frame RB of the rover: child of the odometry.")
    locsb_frame: str = param("locsb", doc="Name of the frame LOCSB of the stereo rig in /tf_static.")
    publish_tf: bool = param(True, doc="Publish the transform from ds to rb on /tf if tf2_msgs is installed.")
    resume_file: str = param(
        "",
        doc="File in which the last known pose is saved, so that localisation resumes there after a crash. Empty: the "
        "pose is not saved.",
    )
    resume_max_age_s: float = param(
        60.0,
        unit="s",
        doc="Maximum age of the saved pose, relative to the stamp of the first pair, at which localisation resumes.",
        low=0.1,
        high=1e6,
    )
    T_rb_locsb: ExtrinsicsConfig = field(default_factory=ExtrinsicsConfig)
    motion_prior: MotionPriorConfig = field(default_factory=MotionPriorConfig)
    localisation: LocalisationConfig = field(default_factory=LocalisationConfig)


class LocalisationNode(PairNode[LocalisationNodeConfig]):
    """Publishes the pose of RB in DS for each stereo pair."""

    task = Task.LOCALISATION
    live_parameters = ("localisation.",)
    config_type = LocalisationNodeConfig

    def check_config(self, config: LocalisationNodeConfig) -> None:
        """Check frames, extrinsics and masks; if the rig is known, also create a localiser to check all parameters."""
        config.check_frame_names(config.ds_frame, config.rb_frame, config.locsb_frame)
        T_rb_sb = config.T_rb_locsb.transform("T_rb_locsb")
        for mask in filter(None, (config.localisation.left_mask, config.localisation.right_mask)):
            read_mask(mask)
        if self.rig is not None:
            rig = replace(self.rig, T_rb_sb=T_rb_sb or Transform.identity())
            Localiser(rig, config.localisation, Transform.identity())

    def setup(self) -> None:
        """Load compiled code and create publishers."""
        super().setup()
        config, add_publisher = self.config, self.endpoints.add_publisher
        self.load_kernels("localisation")
        if self._pose_file is not None:
            self._pose_file.check()
        self.meter.mark_idle()
        self._odometry = add_publisher(Odometry, ESTIMATE, ODOMETRY_DEPTH)
        self._path_publisher = add_publisher(PathMsg, ESTIMATED_PATH, 1, latched=True)
        self._pose_set = add_publisher(PoseWithCovarianceStamped, INITIAL_POSE_SET, 1, latched=True)
        self._tracks = add_publisher(PointCloud2, TRACKS, 2)
        self._image = add_publisher(Image, DEBUG_IMAGE, 2)
        tf_type = tf_message_type() if config.publish_tf else None
        self._tf = add_publisher(tf_type, TF, 100) if tf_type else None

    def subscribe(self) -> None:
        """Subscribe and offer services."""
        add_subscription, depth = self.endpoints.add_subscription, self.config.input.queue_depth
        # Subscribe first, so that a pose that was sent before the first pair is handled before that pair.
        kind = PoseWithCovarianceStamped
        add_subscription(kind, INITIAL_POSE, self._on_initial_pose, QoSProfile(depth=1), of_one_publisher=False)
        self._extrinsics.subscribe(self.endpoints, self.get_logger().info)
        add_subscription(Odometry, MOTION_PRIOR, self._on_motion_prior, profile("best_effort", depth))
        super().subscribe()
        self.add_service("~/reset", self._reset, first=self.forget_waiting)

    def waits_for(self) -> str:
        """Return in one line what the node waits for; empty if nothing is missing."""
        missing = super().waits_for()
        if not missing and self._extrinsics.T_rb_sb is None:
            missing = (
                "Waiting for the extrinsics of the stereo rig: give the parameters T_rb_locsb.translation_m and "
                "T_rb_locsb.quat_xyzw, or publish them on /tf_static"
            )
        return missing

    def reset_state(self) -> None:
        """Create the state of the node, without input and results."""
        super().reset_state()
        config = self.config
        self._pose_file = PoseFile(Path(config.resume_file), config.resume_max_age_s) if config.resume_file else None
        self._session = LocalisationSession(config.localisation, self._pose_file, self.status.warn)
        self._rb_frame = config.frame(config.rb_frame)
        base = "" if config.rb_frame == RB_FRAME else self._rb_frame
        self._extrinsics = Extrinsics(config.T_rb_locsb, base, config.frame(config.locsb_frame))
        self._motion_prior = OdometryBuffer()
        self._priors_received = 0  # messages since `report_periodically`
        self._pairs_by_prior = {True: 0, False: 0}  # pairs since `report_periodically`, by whether a motion was known
        self._path: ThinnedPath[PoseStamped] = ThinnedPath()
        self._path_ns: int | None = None  # stamp of the last published path

    def report_periodically(self) -> None:
        """Also report odometry that is received but gives no motion for any pair."""
        super().report_periodically()
        received = self._priors_received
        pairs = self._pairs_by_prior
        self._priors_received = 0
        self._pairs_by_prior = {True: 0, False: 0}
        image_ns = self._stereo.last_ns
        odometry_ns = self._motion_prior.last_ns
        if not received or pairs[True] or not pairs[False] or image_ns is None:
            return
        off = "it has no usable stamp"
        if odometry_ns is not None:
            off_s = (odometry_ns - image_ns) / NS_PER_S
            off = (
                f"its stamps differ by {off_s:.6g} s from those of the images, or it does not cover the time since the "
                "last known pose"
            )
        self.status.warn(
            f"{MOTION_PRIOR} is received but not used: {off}; stamp it with the clock of the images, publish it "
            "without gaps, or, if it is only late, increase motion_prior.wait_s",
            MOTION_PRIOR,
        )

    def apply_config(self, config: LocalisationNodeConfig) -> None:
        """Continue at the last pose with changed parameters."""
        self.worker.enqueue(partial(self._session.set_config, config.localisation))

    def restart_after_fault(self) -> None:
        """Continue at the last pose."""
        self._session.continue_at_last_pose()

    # ---- in the executor's thread

    def on_new_run(self, reason: str) -> None:
        """Start a new run at the first pose once the pairs received earlier are processed."""
        self.get_logger().warning(f"{reason}: localisation restarts at its first pose")
        self.worker.enqueue(self._session.restart)

    def on_pair(self, pair: ReceivedPair) -> None:
        """Enqueue a pair with the extrinsics of its rig for the worker."""
        self._extrinsics.search(pair.frame_id, pair.rig.baseline_m, self.get_logger().info)
        rig = replace(pair.rig, T_rb_sb=self._extrinsics.T_rb_sb)
        self.worker.enqueue_droppable(partial(self._process, replace(pair, rig=rig)))

    def _on_initial_pose(self, message: PoseWithCovarianceStamped) -> None:
        with self.ignoring_broken():
            self.config.check_message_frame(INITIAL_POSE, message.header.frame_id, "ds_frame")
            pose, last_ns = start_pose_of(message), self._stereo.last_ns
            if pose.stamp_ns is not None and last_ns is not None and last_ns - pose.stamp_ns > MAX_POSE_AGE_NS:
                self.worker.enqueue(partial(self._session.set_first, pose))  # a restarted run may begin near that time
                self.status.warn(
                    f"initialpose is {(last_ns - pose.stamp_ns) / NS_PER_S:.0f} s older than the images: use a stamp "
                    f"at most {MAX_POSE_AGE_NS // NS_PER_S} s older, or the stamp 0 for the next pair; this pose is "
                    "used only when a new run starts"
                )
                return
            self.worker.enqueue(partial(self._set_pose, pose, message))

    def _on_motion_prior(self, message: Odometry) -> None:
        with self.ignoring_broken():
            self.config.check_message_frame(MOTION_PRIOR, message.child_frame_id, "rb_frame")
            self._priors_received += 1
            self._motion_prior.add(stamp_of(message), transform_from_pose(message.pose.pose, MOTION_PRIOR))

    # ---- in the worker's thread

    def _set_pose(self, pose: StartPose, message: PoseWithCovarianceStamped) -> None:
        """Set a start pose, and acknowledge the pose by publishing its message on `initialpose_set`."""
        self._session.set_pose(pose)
        self._pose_set.publish(message)

    def _reset(self) -> str:
        self._session.reset()
        self._path.clear()
        self._path_ns = None
        return "localisation restarts at the identity"

    def _process(self, received: ReceivedPair) -> None:
        pair, conversion_s = decoded(received)
        estimate, call = self._estimate(pair, received.rig)
        self.publish_estimate(estimate)
        times = self.times(received, conversion_s)
        self._publish_tracks(pair, estimate, header_msg(pair.stamp_ns, received.frame_id))
        self.publish_call(replace(call, times=times), LEVELS[estimate.state])

    def _estimate(self, pair: StereoPair, rig: StereoRig) -> tuple[PoseEstimate, CallRecord]:
        """Localise a pair of a rig; return the estimate and the record of the call."""
        if self._session.set_rig(rig):
            self.get_logger().warning("the cameras have changed: localisation restarts at its last pose")
        localiser = self._session.localiser_at(pair.stamp_ns)
        known_ns, wait_s = localiser.known_ns, self.config.motion_prior.wait_s
        motion = None if known_ns is None else self._motion_prior.between(known_ns, pair.stamp_ns, wait_s)
        self._pairs_by_prior[motion is not None] += known_ns is not None
        with self.meter.measure() as usage:
            estimate = localiser.process(pair, motion)
        self._session.accept(estimate)
        return estimate, call_of_estimate(estimate, usage, {} if motion is None else {"motion_prior": 1.0})

    def publish_estimate(self, estimate: PoseEstimate) -> None:
        """Publish odometry and, unless tracking is lost, tf and the path; estimates are in the order of the pairs."""
        message = odometry_msg(estimate, self.config.frame(self.config.ds_frame), self._rb_frame)
        self._odometry.publish(message)
        if estimate.state is TrackingState.LOST:
            return
        header, pose = message.header, message.pose.pose
        if self._tf is not None:
            self._tf.publish(self._tf.msg_type(transforms=[transform_msg(header, self._rb_frame, pose)]))
        stamp_ns, before_ns = estimate.stamp_ns, self._path_ns
        self._path.add(stamp_ns, estimate.T_ds_rb, PoseStamped(header=header, pose=pose))
        # A path may have 2000 poses, so it is published once a second.
        if before_ns is None or not before_ns <= stamp_ns < before_ns + NS_PER_S:
            self._path_publisher.publish(PathMsg(header=header, poses=list(self._path.poses)))
            self._path_ns = stamp_ns

    def _publish_tracks(self, pair: StereoPair, estimate: PoseEstimate, header: Header) -> None:
        """Publish the tracks and the image with drawn tracks, each only while there are subscribers."""
        if self._tracks.get_subscription_count():
            rows = np.empty((0, len(TRACK_FIELDS)), np.float32)
            if (tracks := estimate.tracks) is not None:
                rows = np.column_stack((tracks.uv, tracks.keyframe_uv, tracks.residual))
            self._tracks.publish(float_points_msg(rows, TRACK_FIELDS, header))
        if self._image.get_subscription_count():
            self._image.publish(image_msg(draw_tracks(pair.left, estimate), "bgr8", header))


main = partial(run, LocalisationNode)
