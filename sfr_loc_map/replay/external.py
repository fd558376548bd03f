"""Test an external node in place of one of the suite's nodes.

Its messages are read leniently, and the converted results are published for the monitor. If its process ends during the
replay, this is a finding.

Poses are stored as published and converted twice. During the replay each pose is converted for the monitor and the
page, by the declared convention. After the replay all poses are converted for the score (`external_poses`), because a
diagnosis of the convention requires all poses. Clouds are converted once, when received: points are stored in LM.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import PointCloud2

from sfr_loc_map.calls.call_record import CallRecord
from sfr_loc_map.errors import ConfigError, GeometryError, InputError, MetricsError, NodeError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.sequence import LocSequence, NavSequence, Source
from sfr_loc_map.message_stamps import stamp_of
from sfr_loc_map.metrics.conventions.pose_convention import (
    FIRST_POSE,
    PoseConvention,
    aligned_estimates,
    converted_estimates,
    world_at_first_pose,
)
from sfr_loc_map.metrics.frames.association import UPPER, Estimates, symmetric
from sfr_loc_map.metrics.table.records import ConventionRecord, ExternalScore, MethodKind, MethodRecord
from sfr_loc_map.replay.answer_book import AnswerBook
from sfr_loc_map.replay.options import ExternalOptions
from sfr_loc_map.replay.process_watch import ProcessWatch, processes_watched
from sfr_loc_map.replay.received import ReceivedResults
from sfr_loc_map.replay.replay_peer import ReplayPeer
from sfr_loc_map.replay.result import ExternalResult
from sfr_loc_map.ros import environment, messages
from sfr_loc_map.ros.processes import ChildProcess
from sfr_loc_map.ros.publishers import UNKNOWN_NODE
from sfr_loc_map.ros.qos import LATCHED
from sfr_loc_map.suite_names import Task
from sfr_loc_map.topics import RECTIFIED

DEPTH = 1000
PUBLISHER_GRACE_S = 2.0
"""Maximum wait for the publisher of a subscribed node. Some nodes create their publisher with the first result."""
CHECK_PERIOD_S = 0.2  #: Period of the checks of its publishers.
WORLD, BODY, MAP = "ds", "rb", "lm"  #: Frames of the converted messages, as the nodes of the suite name them.


class ExternalNode(ABC):
    """An external node in place of one of the suite's nodes."""

    kind: type[Any]

    def __init__(
        self, peer: ReplayPeer, options: ExternalOptions, command: ChildProcess | None, results: ReceivedResults
    ) -> None:
        """Set the process of the node, None if the node was not started by the replay.

        The poses or clouds that the node publishes are added to `results`.
        """
        self.options = options
        self._version: str | None = None  # version that the calls report
        self._peer, self._command = peer, command
        self._name = "external" if command is None else command.name  # until the graph reports the node
        self._watch: ProcessWatch | None = None
        self._is_measured = True  # whether the watched processes publish the answers, as far as is known
        self._results = results
        self._answers = AnswerBook(options.timeout_s, options.frames)
        self._publishers: set[tuple[int, ...]] | None = None  # global ids of the publishers at the first answer
        self._checked_s = 0.0

    @abstractmethod
    def read(self, message: Any) -> Any:  # noqa: ANN401 - of `kind`
        """Return the content of a message; raise an InputError if the message is not a valid result."""

    @abstractmethod
    def accept(self, message: Any, content: Any) -> None:  # noqa: ANN401 - of `kind`
        """Add the content of a message to the results, and publish the converted message."""

    def note_sent(self, stamp_ns: int, sent_s: float) -> None:
        """Record a pair and the time of the monotonic clock when its last image was published, s."""
        if (early := self._answers.note_sent(stamp_ns, sent_s)) is not None:
            self.accept(*early)

    def note_call(self, call: CallRecord) -> None:
        """Record a call that the node has reported, and the version of the node if the call states it."""
        self._version = call.version or self._version

    def wait_until_ready(self, topics: Iterable[str]) -> None:
        """Wait until the node subscribes to images, subscribe to its answers, and start measuring its process.

        `topics` are the topics of the replay.
        """
        rig = f"{self.options.task.rig}/"
        self._wait_for_subscription([name for name in topics if name.startswith(rig) and RECTIFIED in name])
        self._subscribe_to_answers()
        pids = [] if self._command is None else [self._command.popen.pid]
        if self.options.watch:
            pids = processes_watched(self.options.watch, pids)
        self._watch = ProcessWatch(pids) if pids else None
        self._check_watch()

    def _wait_for_subscription(self, topics: list[str]) -> None:
        """Wait until the node subscribes to one of the topics; raise a NodeError if its process ends or it does not."""
        graph, command = self._peer.ros_node, self._command

        def listens() -> bool:
            if command is not None and command.ending:
                raise NodeError(f"the external node {_ended(command)}; correct the cause and start again")
            return any(graph.count_subscribers(topic) for topic in topics)

        def problem() -> str:
            domain = environment.domain()
            return (
                f"no external node in ROS domain {domain} subscribes to {' or '.join(topics)}: start the node with "
                "--command, or set ROS_DOMAIN_ID for both, and remap its topics; no subscription"
            )

        self._peer.wait_for(listens, self.options.start_timeout_s, problem)

    def _subscribe_to_answers(self) -> None:
        """Subscribe with the reliability that the publishers offer, and take the name of the node from the graph."""
        graph = self._peer.ros_node

        def are_named() -> bool:
            names = [item.node_name for item in graph.get_publishers_info_by_topic(self.options.topic)]
            return bool(names) and UNKNOWN_NODE not in names

        self._peer.spin(PUBLISHER_GRACE_S, are_named)
        publishers = list(graph.get_publishers_info_by_topic(self.options.topic))
        names = {item.node_name for item in publishers} - {UNKNOWN_NODE}
        self._name = ", ".join(sorted(names)) or self._name
        reliable = {item.qos_profile.reliability for item in publishers} == {ReliabilityPolicy.RELIABLE}
        policy = ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
        quality = QoSProfile(depth=DEPTH, reliability=policy)
        graph.create_subscription(self.kind, self.options.topic, self._on_answer, quality)

    def _check_watch(self) -> None:
        """Note whether the watched processes publish the answers."""
        self._is_measured = self._watch is None or self._watch.has_publishers(self._present_publishers())

    def result(self) -> ExternalResult:
        """Return answers and process of the node, and stop measuring the process; called while the process runs."""
        with suppress(ConfigError):  # a wrong process to watch has ended the replay
            self.check_process()
        if self._watch is not None:
            self._watch.stop()
        answers, options = self._answers, self.options
        score = ExternalScore(
            task=options.task.value,
            topic=options.topic,
            frames=answers.frames,
            answers=answers.counts,
            latency_s=answers.latency_s,
            process=None if self._watch is None or not self._is_measured else self._watch.usage,
            ended=answers.ended,
        )
        method = MethodRecord(name=self._name, version=self._version, kind=MethodKind.EXTERNAL)
        log, declared = "" if self._command is None else self._command.text, options.convention.settings
        of_cloud = ConventionRecord(declared=declared) if options.task is Task.MAPPING and declared else None
        return ExternalResult(method, score, answers.findings, log, of_cloud)  # poses are converted later

    def wait_for(self, stamp_ns: int) -> None:
        """Wait until a pair is answered, its timeout has passed, or the process has ended."""

        def settled() -> bool:
            self.check_process()
            return self.is_settled(stamp_ns)

        timeout_s = self.options.timeout_s + 60.0  # each pair is settled earlier
        self._peer.wait_for(settled, timeout_s, lambda: f"the node under test did not answer the pair {stamp_ns}")
        self._answers.note_waited(stamp_ns)

    def is_settled(self, stamp_ns: int) -> bool:
        """Return whether a pair is answered, or its answer is no longer awaited."""
        return self._answers.is_settled(stamp_ns)

    def check_process(self) -> None:
        """Note whether the process of the node has ended, even if a script has restarted it.

        A restarted process has another publisher, with another global id.
        """
        if self._command is not None and self._command.ending:
            self._answers.note_end(_ended(self._command))
            return
        if self.options.watch and not self._is_measured:
            raise ConfigError(
                f"'--watch {self.options.watch}': the publisher of {self.options.topic} belongs to another process; "
                "give the process of the node under test"
            )
        now_s = time.monotonic()
        if self._publishers is None or now_s - self._checked_s < CHECK_PERIOD_S:
            return
        self._checked_s = now_s
        if self._present_publishers() != self._publishers:
            topic = self.options.topic
            self._answers.note_restart(
                f"the publisher of its first answer on {topic} has left, or another has appeared"
            )

    def _present_publishers(self) -> set[tuple[int, ...]]:
        found = self._peer.ros_node.get_publishers_info_by_topic(self.options.topic)
        return {tuple(item.endpoint_gid) for item in found}

    def _on_answer(self, message: Any) -> None:  # noqa: ANN401 - rclpy has no types
        if self._publishers is None:
            self._publishers = self._present_publishers()
            self._check_watch()
        content, problem = None, ""
        try:
            content = self.read(message)
        except InputError as error:
            problem = str(error)
        frames = message.header.frame_id
        if self.kind is Odometry:
            frames += f" -> {message.child_frame_id}"
        stamp_ns = stamp_of(message)
        is_used = self._answers.note_answer(stamp_ns, frames, problem, (message, content))
        if is_used and self._answers.has_pair(stamp_ns):
            self.accept(message, content)


class ExternalLocaliser(ExternalNode):
    """An external localiser, which publishes poses."""

    kind = Odometry

    def __init__(
        self,
        peer: ReplayPeer,
        options: ExternalOptions,
        command: ChildProcess | None,
        results: ReceivedResults,
        loc: LocSequence,
    ) -> None:
        """Create the publisher of converted poses. The convention may require the rig and the ground truth."""
        super().__init__(peer, options, command, results)
        self._convention, self._truth = options.convention, loc.ground_truth
        self._in_own_world = replace(options.convention, world="ds")
        self._T_rb_child = options.convention.T_rb_child(loc.rig)
        self._T_ds_world: Transform | None = None
        self._publisher = peer.ros_node.create_publisher(Odometry, options.converted_topic, QoSProfile(depth=DEPTH))

    def read(self, message: Odometry) -> messages.OdometryRow:
        """Return stamp, position and quaternion."""
        return messages.odometry_row(message)

    def accept(self, message: Odometry, row: messages.OdometryRow) -> None:
        """Add a pose as published, and publish the converted pose."""
        covariance = messages.covariance_of(message)
        self._results.add_pose(row, covariance)
        try:
            poses = Trajectory(np.array([row[0]], np.int64), np.array([row[1]]), np.array([row[2]]))
            published = Estimates.of(poses, covariance=covariance[None, *UPPER])
            estimates = converted_estimates(published, self._in_own_world, self._T_rb_child, None)
            if self._convention.world == FIRST_POSE:
                if self._T_ds_world is None:
                    self._T_ds_world = world_at_first_pose(estimates, self._truth)
                estimates = aligned_estimates(estimates, self._T_ds_world)
        except (GeometryError, MetricsError):
            return  # the pose cannot be converted; the score reports the reason
        poses = estimates.trajectory
        out = Odometry(header=messages.header_msg(max(int(poses.stamps_ns[0]), 0), WORLD), child_frame_id=BODY)
        out.pose.pose = messages.pose_msg(poses.pose(0), poses.quats_xyzw[0])
        if estimates.covariance is not None:
            out.pose.covariance = symmetric(estimates.covariance[0]).reshape(36)
        self._publisher.publish(out)


class ExternalMapper(ExternalNode):
    """An external mapper, whose clouds have only points or all fields of `mapping/points`."""

    kind = PointCloud2

    def __init__(
        self,
        peer: ReplayPeer,
        options: ExternalOptions,
        command: ChildProcess | None,
        results: ReceivedResults,
        nav: NavSequence,
    ) -> None:
        """Create the publisher of converted clouds, whose points are transformed to LM by the poses of the pairs."""
        super().__init__(peer, options, command, results)
        convention, here = options.convention, replace(nav.rig, T_rb_sb=Transform.identity())
        self._in_lm = convention == PoseConvention(metres_per_unit=convention.metres_per_unit)
        self._unit, self._T_sb_child = convention.metres_per_unit, convention.T_rb_child(here)
        self._poses = {item.pair.stamp_ns: item.T_lm_navsb for item in nav.pairs()}
        self._publisher = peer.ros_node.create_publisher(PointCloud2, options.converted_topic, LATCHED)

    def read(self, message: PointCloud2) -> FloatArray:
        """Return the points `(N, 3)` in LM."""
        stamp_ns, points = stamp_of(message), messages.xyz_from_msg(message) * self._unit
        if self._in_lm:
            return points
        if stamp_ns not in self._poses:
            raise InputError(
                f"no pair has the stamp {stamp_ns} of the cloud, so its points cannot be transformed to LM: "
                "publish the cloud with the stamp of its pair"
            )
        return (self._poses[stamp_ns] @ self._T_sb_child).apply(points)

    def accept(self, message: PointCloud2, points: FloatArray) -> None:
        """Add the finite points in LM, and publish the cloud, with its points in LM, if it has all fields."""
        stamp_ns = stamp_of(message)
        self._results.add_points(stamp_ns, points[np.isfinite(points).all(axis=1)])
        try:
            cloud = messages.cloud_from_msg(message)
        except InputError:
            return  # points without pixels are scored against the nearest true point
        cloud = replace(cloud, xyz=points.astype(np.float32))
        self._results.add_cloud(stamp_ns, cloud)
        self._publisher.publish(messages.cloud_msg(cloud, stamp_ns, MAP))


def _ended(command: ChildProcess) -> str:
    return f"{command.ending}: {command.last_log_line[:200]}"


def external_node(
    peer: ReplayPeer,
    source: Source,
    options: ExternalOptions | None,
    command: ChildProcess | None,
    results: ReceivedResults,
) -> ExternalNode | None:
    """Return the external node of a replay; None without options."""
    if options is None:
        return None
    if options.task is Task.LOCALISATION and source.loc is not None:
        return ExternalLocaliser(peer, options, command, results, source.loc)
    if options.task is Task.MAPPING and source.nav is not None:
        return ExternalMapper(peer, options, command, results, source.nav)
    raise ConfigError(
        f"'--external {options.task}': the source has no pairs for this task; give a source that has them"
    )
