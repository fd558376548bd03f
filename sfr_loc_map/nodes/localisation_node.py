"""The localisation node: stereo pairs in, odometry out.

Messages are received in the executor's thread and handed in order to the worker's thread, which alone touches the
localiser; a new rig, pose or configuration takes its place in that order.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped, Vector3
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Image

from sfr_loc_map.config import param
from sfr_loc_map.constants import NS_PER_S
from sfr_loc_map.errors import InputError, OutputError, SfrError
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.image_codec import stamp_of
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.estimate import PoseEstimate, TrackingState
from sfr_loc_map.localisation.localiser import Localiser
from sfr_loc_map.localisation.visualisation import draw_tracks
from sfr_loc_map.nodes.diagnostics.call_reporter import CallReporter
from sfr_loc_map.nodes.diagnostics.key_values import Level
from sfr_loc_map.nodes.input.extrinsics import MountConfig
from sfr_loc_map.nodes.input.odometry_buffer import OdometryBuffer
from sfr_loc_map.nodes.input.static_transforms import StaticTransforms
from sfr_loc_map.nodes.input.stereo_subscriber import ReceivedPair, StereoInput, StereoInputConfig
from sfr_loc_map.nodes.lifecycle.managed_node import ManagedNode, PairNodeConfig
from sfr_loc_map.nodes.lifecycle.qos import profile
from sfr_loc_map.nodes.messages.fields import header_msg
from sfr_loc_map.nodes.messages.image import image_msg
from sfr_loc_map.nodes.messages.pose import odometry_msg, tf_message_type, transform_from_pose
from sfr_loc_map.nodes.process.runner import run
from sfr_loc_map.pipeline.online.latency import latencies
from sfr_loc_map.pipeline.online.resume import KnownPose, PoseFile

NAME = "localisation_node"
DEBUG_DEPTH = 2
LEVELS = {
    TrackingState.INITIALISING: Level.WARN,
    TrackingState.TRACKING: Level.OK,
    TrackingState.LOST: Level.ERROR,
}


@dataclass(frozen=True, slots=True)
class MotionPriorConfig:
    """How wheel odometry on the topic motion_prior is used."""

    max_gap_s: float = param(
        0.5, unit="s", doc="Neighbouring messages further apart do not cover what lies between.", low=0.001, high=60.0
    )
    wait_s: float = param(
        0.0,
        unit="s",
        doc="How long a pair waits for a message at or after its stamp, once such messages come; 0: not at all.",
        low=0.0,
        high=10.0,
    )


@dataclass(frozen=True, slots=True)
class LocalisationNodeConfig(PairNodeConfig):
    """Parameters of the localisation node."""

    ds_frame: str = param("ds", doc="Name of the world frame DS: parent of the odometry.")
    rb_frame: str = param("rb", doc="Name of the rover's frame RB: child of the odometry.")
    locsb_frame: str = param("locsb", doc="Name of the stereo bench's frame LOCSB in /tf_static.")
    publish_tf: bool = param(True, doc="Publish ds to rb on /tf, where tf2_msgs is installed.")
    output_depth: int = param(
        1000,
        unit="messages",
        doc="Depth of the odometry's queue: so many are kept for a subscriber that is held up.",
        low=1,
        high=10000,
    )
    resume_file: str = param(
        "",
        doc="File that keeps the pose known last, so that a node that was killed goes on there; empty: none is kept.",
    )
    resume_max_age_s: float = param(
        60.0, unit="s", doc="A kept pose this much older than the first pair is not gone on from.", low=0.1, high=1e6
    )
    T_rb_locsb: MountConfig = field(default_factory=MountConfig)
    input: StereoInputConfig = field(default_factory=StereoInputConfig)
    motion_prior: MotionPriorConfig = field(default_factory=MotionPriorConfig)
    localisation: LocalisationConfig = field(default_factory=LocalisationConfig)


class LocalisationNode(ManagedNode):
    """Publishes the pose of RB in DS for each stereo pair.

    Attributes:
        config_type: Its parameters; a subclass may have more, by a dataclass that derives from this one.
    """

    config_type: type[LocalisationNodeConfig] = LocalisationNodeConfig

    _input: StereoInput | None = None
    _pose_file: PoseFile | None = None

    def __init__(self, name: str = NAME, **options: Any) -> None:  # noqa: ANN401
        """Declare the parameters.

        Args:
            name: Name of the node.
            options: Of `rclpy.node.Node`.

        Raises:
            ConfigError: If a parameter is unknown or not valid.
        """
        super().__init__(name, "localisation", self.config_type, live=("localisation.",), **options)
        self.free()

    def check(self, config: LocalisationNodeConfig) -> None:
        """Try whether a localiser can be made with the parameters and the rig, where that is known."""
        mount = config.T_rb_locsb.transform()
        if self._input is not None and self._input.rig is not None:
            rig = replace(self._input.rig, T_rb_sb=mount or Transform.identity())
            Localiser(rig, config.localisation, Transform.identity())

    def make(self) -> None:
        """Warm up, advertise."""
        config: LocalisationNodeConfig = self.config
        Localiser.warm_up()  # before the first picture: no call pays for it
        self._settings_in_force = config.localisation
        self._mount = config.T_rb_locsb.transform()
        self._calls = CallReporter(self, self.task, self.diagnostics)
        file = config.resume_file
        if file:
            self._pose_file = PoseFile(Path(file), config.resume_max_age_s)
        self._resumes = self._pose_file is not None
        self._prior = OdometryBuffer(round(config.motion_prior.max_gap_s * NS_PER_S))
        self._odometry = self.publish_on(Odometry, "localisation/odometry", config.output_depth)
        self._debug_picture = self.publish_on(Image, "localisation/debug_image", DEBUG_DEPTH)
        kind = tf_message_type() if config.publish_tf else None
        self._tf = self.publish_on(kind, "/tf", 100) if kind else None

    def listen(self) -> None:
        """Subscribe and offer services."""
        config: LocalisationNodeConfig = self.config
        # First, so that a pose sent before the first pair is handled before it.
        self.listen_to(PoseWithCovarianceStamped, "initialpose", self._on_initial_pose, QoSProfile(depth=1))
        if self._mount is None:
            self._frames.subscribe(self, self._look_up_mount)
        prior_qos = profile("best_effort", config.input.queue_depth)
        self.listen_to(Odometry, "motion_prior", self._on_motion_prior, prior_qos)
        self._input = StereoInput(
            self,
            "loc",
            config.input,
            on_pair=lambda pair: self.worker.offer(lambda: self._on_pair(pair)),
            on_rig=lambda rig: self.worker.put(lambda: self._on_rig(rig)),
            on_jump_back=lambda: self._restart("stamps have gone back"),
        )
        self.offer("~/reset", self._reset, first=self._forget_waiting)
        if self._mount is None:
            source = "/tf_static is awaited" if tf_message_type() else "tf2_msgs for /tf_static is not installed"
            self.get_logger().warning(f"the place of the stereo bench (parameters T_rb_locsb) is not given: {source}")

    def free(self) -> None:
        """Forget everything."""
        self._input = None
        self._rig: StereoRig | None = None
        self._localiser: Localiser | None = None
        self._known_ns: int | None = None
        self._first_pose = self._next_pose = Transform.identity()
        self._pose_file = None
        self._resumes = False
        self._resumed: KnownPose | None = None
        self._known: tuple[KnownPose, ...] = ()
        self._frames = StaticTransforms()

    def clock_back(self) -> None:
        """Begin a new run, unless its pairs have come already."""
        if self._input is not None and self._input.is_ahead():
            self._restart("the clock has gone back")

    def _restart(self, reason: str) -> None:
        """Begin a new run at the first pose, after the pairs that came before."""
        if self._input is not None:
            self._input.restart()
        self.get_logger().warning(f"{reason}: localisation starts anew at its first pose")
        self.worker.put(self._begin_run)

    def adopt(self, config: LocalisationNodeConfig) -> None:
        """Start anew at the last pose with other parameters."""

        def change() -> None:
            self._settings_in_force = config.localisation
            self._go_on()

        self.worker.put(change)

    def counts(self) -> dict[str, int]:
        """Return what was dropped since the start, by name."""
        return (self._input.statistics() if self._input is not None else {}) | super().counts()

    def restart_after_fault(self) -> None:
        """Start anew at the last pose."""
        self._go_on()
        if self._input is not None:
            self._input.counts.broken += 1

    # ---- in the executor's thread

    def _look_up_mount(self) -> None:
        if self._mount is None:
            self._mount = self._frames.find(self.config.rb_frame, self.config.locsb_frame)

    def _on_initial_pose(self, message: PoseWithCovarianceStamped) -> None:
        frame = message.header.frame_id
        if frame not in ("", self.config.ds_frame):
            self.warn(f"initialpose is in '{frame}', '{self.config.ds_frame}' is needed: ignored")
            return
        try:
            pose = transform_from_pose(message.pose.pose, "initialpose")
        except InputError as error:
            self.warn(f"{error}; ignored")
            return
        self.worker.put(lambda: self._set_pose(pose))

    def _on_motion_prior(self, message: Odometry) -> None:
        child, wanted = message.child_frame_id, self.config.rb_frame
        try:
            if child not in ("", wanted):
                raise InputError(f"motion_prior is of '{child}', of '{wanted}' (parameter rb_frame) is needed")
            pose = transform_from_pose(message.pose.pose, "motion_prior")
        except InputError as error:
            self.warn(f"{error}; ignored")
            return
        self._prior.add(stamp_of(message), pose)

    def _forget_waiting(self) -> None:
        self.worker.clear()
        if self._input is not None:
            self._input.restart()

    # ---- in the worker's thread

    def _on_rig(self, rig: StereoRig) -> None:
        if self._rig is not None and self._rig.same_cameras(rig):
            return  # the node was inactive meanwhile
        if self._rig is not None:
            self.get_logger().warning("camera_info has changed: localisation starts anew at its last pose")
        self._rig = rig
        self._go_on()

    def _go_on(self) -> None:
        """Let the next pair begin anew at the last pose, as well known as it was and a step on."""
        if self._localiser is not None and self._known:
            self._resumed = self._known[-1].after_step(self._known[0])
        self._localiser = None

    def _begin_run(self) -> None:
        self._localiser, self._next_pose = None, self._first_pose
        self._resumes, self._resumed, self._known = False, None, ()

    def _reset(self) -> str:
        self._first_pose = Transform.identity()
        self._begin_run()
        return "localisation starts anew at the identity"

    def _set_pose(self, pose: Transform) -> None:
        self._first_pose = self._next_pose = pose
        self._resumes, self._resumed, self._known = False, None, ()
        if self._localiser is not None:
            self._localiser.set_pose(pose)

    def _on_pair(self, received: ReceivedPair) -> None:
        begin = time.perf_counter()
        try:
            pair = received.decode()
            conversion_s = time.perf_counter() - begin
            localiser = self._localiser or self._begin(pair.stamp_ns)
            motion = self._motion(pair)
            with self._calls.measure() as usage:
                estimate = localiser.process(pair, motion)
        except SfrError as error:
            if self._input is not None:
                self._input.counts.broken += 1
            self.report_problem(str(error))
            return
        self._next_pose = estimate.T_ds_rb
        if estimate.state is not TrackingState.LOST:
            self._known_ns = pair.stamp_ns
            estimate = self._keep(estimate)
        self.publish_estimate(estimate)
        self._publish_debug_picture(pair, localiser, estimate)
        now_ns = self.get_clock().now().nanoseconds
        times = latencies(received.receipts, pair.stamp_ns, time.time_ns(), now_ns)
        times |= {"conversion_s": conversion_s}
        statistics = estimate.figures
        if motion is not None:
            statistics["motion_prior"] = 1.0
        level = LEVELS[estimate.state]
        took = self._calls.publish(
            estimate.stamp_ns, usage, estimate.state.value, statistics, self.counts(), level, times
        )
        self.health.called(level, estimate.state.value, took, statistics)
        self.report_health(only_changes=True)

    def _motion(self, pair: StereoPair) -> Transform | None:
        """Return what wheel odometry says of the motion since the pose known last."""
        if self._known_ns is None:
            return None
        return self._prior.between(self._known_ns, pair.stamp_ns, self.config.motion_prior.wait_s)

    def _begin(self, stamp_ns: int) -> Localiser:
        """Make the localiser for the rig, at the pose due at this pair."""
        if self._rig is None or self._mount is None:
            raise InputError(
                "the place of the stereo bench on the rover is not known: give the parameters T_rb_locsb.translation_m "
                "and T_rb_locsb.quat_xyzw, or publish it on /tf_static"
            )
        self._resume(stamp_ns)
        rig = replace(self._rig, T_rb_sb=self._mount)
        self._localiser, self._known_ns = Localiser(rig, self._settings_in_force, self._next_pose), None
        return self._localiser

    def _resume(self, stamp_ns: int) -> None:
        """Go on at the pose that was kept, if this is the first pair after a start and nobody has said a pose."""
        resumes, self._resumes = self._resumes, False
        if not resumes or self._pose_file is None:
            return
        try:
            known = self._pose_file.load(stamp_ns)
        except InputError as error:
            self.warn(str(error))
            return
        if known is not None:
            self._next_pose, self._resumed = known.T_ds_rb, known.after_gap()
            gap_s = (stamp_ns - known.stamp_ns) * 1e-9
            self.warn(f"localisation goes on at the pose of {gap_s:.1f} s before: what was driven since is not known")

    def _keep(self, estimate: PoseEstimate) -> PoseEstimate:
        """Keep a pose before it is published; return it as well known as the start of its run."""
        if self._resumed is not None:
            added = self._resumed.added_covariance(estimate.T_ds_rb)
            estimate = replace(estimate, covariance=estimate.covariance + added)
        known = KnownPose(estimate.stamp_ns, estimate.T_ds_rb, estimate.covariance)
        self._known = (*self._known[-1:], known)
        if self._pose_file is not None:
            try:
                self._pose_file.save(known)
            except OutputError as error:
                self.warn(str(error))
        return estimate

    def _publish_debug_picture(self, pair: StereoPair, localiser: Localiser, estimate: PoseEstimate) -> None:
        """Show what was found in the left picture, where somebody wants to see it."""
        if self._debug_picture.get_subscription_count():
            picture = draw_tracks(pair.left, localiser.last_result, estimate)
            self._debug_picture.publish(image_msg(picture, header_msg(pair.stamp_ns, "")))

    def publish_estimate(self, estimate: PoseEstimate) -> None:
        """Publish odometry, and tf where that is wanted and known; in the node's thread, in the order of the pairs."""
        message = odometry_msg(estimate, self.config.ds_frame, self.config.rb_frame)
        self._odometry.publish(message)
        if self._tf is None or estimate.state is TrackingState.LOST:
            return
        motion = TransformStamped(header=message.header, child_frame_id=self.config.rb_frame)
        place = message.pose.pose.position
        motion.transform.translation = Vector3(x=place.x, y=place.y, z=place.z)
        motion.transform.rotation = message.pose.pose.orientation
        self._tf.publish(self._tf.msg_type(transforms=[motion]))


def main() -> int:
    """Run the node."""
    return run(LocalisationNode)


if __name__ == "__main__":
    raise SystemExit(main())
