"""The monitor node, which scores a run in progress and publishes the figures.

All input is passed in order to the worker. Only the worker's thread accesses the score.
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from msgspec.structs import replace as struct_replace
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile
from sensor_msgs.msg import CameraInfo, PointCloud2
from std_msgs.msg import String

from sfr_loc_map import __version__
from sfr_loc_map.calls.call_message import decode_call
from sfr_loc_map.configuration.parameters import param
from sfr_loc_map.errors import InputError, MetricsError, SfrError
from sfr_loc_map.inputs import MAX_TEXT_BYTES
from sfr_loc_map.io.calibration.rectification import rig_of_infos
from sfr_loc_map.io.clouds.point_image import points_image
from sfr_loc_map.io.truth.config import LiveTruthConfig
from sfr_loc_map.io.truth.messages import TrueRow
from sfr_loc_map.json_yaml import parse_json
from sfr_loc_map.mapping.config import MAX_PAIRS
from sfr_loc_map.message_stamps import stamp_of
from sfr_loc_map.message_types import Level
from sfr_loc_map.metrics.config import MappingState, ScoreConfig
from sfr_loc_map.metrics.figures.records import Provenance
from sfr_loc_map.metrics.judging.limits_file import load_limits
from sfr_loc_map.metrics.score.caveats import copies_caveat
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.stored.score_json import to_json
from sfr_loc_map.nodes.lifecycle.managed_node import ManagedNode
from sfr_loc_map.nodes.lifecycle.parameters import NodeConfig
from sfr_loc_map.nodes.lifecycle.runner import run
from sfr_loc_map.nodes.monitor.score_file import ScoreFile
from sfr_loc_map.nodes.monitor.score_publisher import ScorePacing, ScorePublisher
from sfr_loc_map.nodes.monitor.truth_input import FrameTruthInput, TopicTruthInput, TruthInput
from sfr_loc_map.nodes.stereo.camera_info_pair import CameraInfoPair
from sfr_loc_map.nodes.stereo.stereo_input import StereoInputConfig
from sfr_loc_map.ros.point_messages import cloud_from_msg
from sfr_loc_map.ros.pose_messages import covariance_of, odometry_row, transform_from_pose
from sfr_loc_map.ros.publishers import participants_of
from sfr_loc_map.ros.qos import LATCHED, RELIABILITIES, profile
from sfr_loc_map.ros.transport import TransportGaps, begin_counting
from sfr_loc_map.run_order import CommonRuns
from sfr_loc_map.scoring.live.live_score import MAX_LISTED, DiscardedInterval, LiveRun
from sfr_loc_map.scoring.live.monitor_score import MonitorScore
from sfr_loc_map.suite_names import SIDES, Side, Task
from sfr_loc_map.topics import (
    CLOUD,
    ESTIMATE,
    NAV_POSE,
    TF,
    TF_STATIC,
    TRUE_POINTS,
    TRUE_POSES,
    call_topic,
    configuration_topic,
)
from sfr_loc_map.transport_issues import Reliability
from sfr_loc_map.worker import Overload

ESTIMATES, TRUTH = "estimate", "truth"
SOURCES: dict[str, str] = {
    ESTIMATES: "the estimate",
    TRUTH: "the ground truth",
    NAV_POSE: NAV_POSE,
    Task.LOCALISATION: "the calls of localisation_node",
    **{state: f"the calls of mapping_node ({state})" for state in MappingState},
}
"""Sources of stamped messages, each with its description for log messages. A new run of one source is a new run of all
sources."""
TF_TOPICS = (TF, TF_STATIC)  #: Topics that may have several publishers.
SCORE_PREFIX = "score."  #: Prefix of the parameters that are the settings of the score.
Sender = tuple[type[Any], int]
"""A publisher of a topic: the type of its messages, and the number of returns of the sequence number before."""
IN_FLIGHT_S = 5.0  #: During a run, results of pairs younger than this, s, do not count as missing.


@dataclass(frozen=True, slots=True)
class MonitorInputConfig:
    """How the monitor receives its input."""

    reliability: str = param(
        "best_effort",
        doc="Reliability requested from the publishers of ground_truth/odometry, nav/pose and camera_info; best_effort "
        "matches both kinds. Results and clouds are requested reliably.",
        choices=RELIABILITIES,
    )
    queue_depth: int = param(1000, unit="messages", doc="Depth of the queues of poses and calls.", low=1, high=100000)


@dataclass(frozen=True, slots=True)
class MonitorNodeConfig(NodeConfig):
    """Parameters of the monitor node."""

    publish_period_s: float = param(
        1.0,
        unit="s",
        doc="Period at which figures are published if messages were received. In a long run the period is longer, so "
        "that scoring takes at most 10 % of the time.",
        low=0.05,
        high=3600.0,
    )
    limits_file: str = param("", doc="YAML file with limits. Empty: no limits.")
    save_file: str = param(
        "", doc="JSON file to which ~/save writes the score. An existing file is replaced only if it is a score."
    )
    save_period_s: float = param(
        0.0,
        unit="s",
        doc="Period at which the score is saved if messages were received, to limit the loss in a crash. A score from "
        "before the start is kept as *.before.json. 0: the score is saved only by ~/save.",
        low=0.0,
        high=3600.0,
    )
    input: MonitorInputConfig = field(default_factory=MonitorInputConfig)
    score: ScoreConfig = field(default_factory=ScoreConfig)
    truth: LiveTruthConfig = field(default_factory=LiveTruthConfig)

    def queue(self) -> tuple[Overload, int]:
        """Return a queue that keeps every message up to the queue depth."""
        return Overload.ALL, self.input.queue_depth


class MonitorNode(ManagedNode[MonitorNodeConfig]):
    """Receives estimates, ground truth, clouds and calls, and publishes the score.

    The table shows what happens to the state at a new run of any source and at `~/reset`. A deactivation drops the
    messages that wait for the worker. An activation forgets whether ground truth was received, because its type may
    have changed; all other state is kept. A configuration and a clean-up create all state again (`reset_state`), except
    the list of discarded intervals. Every event that discards received data adds an interval to this list (`_discard`).

    | state | new run | `~/reset` |
    |---|---|---|
    | estimates, ground truth, calls, stamps of images, score of the last map | cleared | cleared |
    | stamps of all sources (`CommonRuns`) | late messages of the previous run are dropped | cleared |
    | clouds, true points and `nav/pose` of maps | kept; clouds of earlier pairs are not scored | likewise |
    | calibration, configurations of the nodes | kept | kept |
    | whether an estimate and the ground truth were received | kept | kept |
    | sequence numbers of the messages by topic (`TransportGaps`) | kept | kept |
    | publishers of the scored messages (`_senders`) | cleared | cleared |
    | type and origin of the ground truth (`TopicTruthInput`) | kept | kept |

    Ground truth from /tf also has runs of its own (`FramePoses`).
    """

    task = "monitor"
    config_type = MonitorNodeConfig
    foreign_parameters = tuple(f"input.{item.name}" for item in fields(StereoInputConfig))

    def __init__(self, name: str = "", **options: Any) -> None:  # noqa: ANN401
        """Create the list of discarded intervals, which is kept until the node ends, and the node."""
        self._received_ns: tuple[int, int] | None = None  # earliest and latest stamp of the data of the present score
        self._discards = 0  # number of discarded intervals in the life of the node
        self._discarded: tuple[DiscardedInterval, ...] = ()  # the latest of them
        super().__init__(name, **options)

    def check_config(self, config: MonitorNodeConfig) -> None:
        """Check the frames of the ground truth."""
        if config.truth.frame:
            FrameTruthInput(config.truth.frame)

    def setup(self) -> None:
        """Read the limits, keep the score of an earlier run, and create publishers."""
        config = self.config
        if config.limits_file:
            limits = load_limits(Path(config.limits_file))
            of_any_data = struct_replace(limits, data_set_sha256=())  # received messages have no recorded source
            self._score = MonitorScore(config.score, of_any_data, config.truth)
        if self._score_file is not None:
            self._score_file.check()
            if config.save_period_s:
                self._warn_on_error(self._score_file.keep_previous)
        self._publisher = ScorePublisher(self.endpoints)

    def subscribe(self) -> None:
        """Subscribe and offer services."""
        config = self.config
        self._has_truth = False
        deep, shallow = QoSProfile(depth=config.input.queue_depth), QoSProfile(depth=10)
        of_rover, info = (profile(config.input.reliability, depth) for depth in (config.input.queue_depth, 10))
        self._receive(Odometry, ESTIMATE, self._on_estimate, deep, on_first=self._set_missed_estimates)
        self._truth.subscribe(self._receive, of_rover, self._add_truth)
        self._receive(PoseStamped, NAV_POSE, self._on_pose, of_rover)
        for side in SIDES:
            self._receive(CameraInfo, f"nav/{side}/camera_info", partial(self._on_camera_info, side), info)
        self.endpoints.add_subscription(CameraInfo, "loc/left/camera_info", self._on_image_info, info)
        self._receive(PointCloud2, TRUE_POINTS, self._on_true_points, shallow)
        self._receive(PointCloud2, CLOUD, self._on_cloud, shallow)
        for task in Task:
            self._receive(String, call_topic(task), partial(self._on_call, task), deep)
            self._receive(String, configuration_topic(task), partial(self._on_configuration, task), LATCHED)
        self.add_service("~/save", self._save)
        self.add_service("~/finish", self._finish)
        self.add_service("~/reset", self._reset)
        self.endpoints.add_timer(config.publish_period_s, lambda: self.worker.enqueue(self._publish_periodically))
        if self._score_file is not None and config.save_period_s:
            self.endpoints.add_timer(config.save_period_s, lambda: self.worker.enqueue(self._autosave))

    def reset_state(self) -> None:
        """Create the score and all other state without input, and record that the received data are discarded."""
        self._discard("clean-up or configuration")
        config = self.config
        self._score = MonitorScore(config.score, None, config.truth)  # `setup` reads the limits
        self._score_file = ScoreFile(Path(config.save_file)) if config.save_file else None
        self._gaps: dict[str, TransportGaps] = {}  # by topic; changed only by the executor's thread
        self._missed_estimates = 0  # published before the first received estimate; 0 after a new run
        self._camera_infos = CameraInfoPair()
        self._truth: TruthInput = (
            FrameTruthInput(config.truth.frame)
            if config.truth.frame
            else TopicTruthInput(self, Reliability(config.input.reliability))
        )
        self._runs: CommonRuns[Callable[[], None]] = CommonRuns(SOURCES, once=(TRUTH,))
        self._restarts = 0  # number of new runs since the operator's reset
        self._senders: dict[str, set[Sender]] = {}  # of the messages of the run, by topic
        self._sender = "", (String, 0)  # topic and publisher of the message that the worker handles
        self._is_truth_of_item = False
        self._has_estimate = False
        self._has_truth = False
        self._early_points: deque[PointCloud2] = deque(maxlen=MAX_PAIRS)  # received before camera_info
        self._configurations: dict[str, Any] = {}
        self._changed = self._unsaved = False
        self._pacing = ScorePacing()
        self._last_ns = 0

    def counts(self) -> dict[str, int]:
        """Return the numbers of messages dropped since the configuration, by cause."""
        dropped = {
            "dropped_in_transport": sum(gaps.lost for gaps in list(self._gaps.values())),
            "dropped_stray": self._runs.strays + self._truth.strays,
        }
        return dropped | super().counts()

    def report_periodically(self) -> None:
        """Log how many messages were dropped, follow a change of the truth's type, and report why nothing is scored."""
        super().report_periodically()
        for topic, gaps in self._gaps.items():
            if topic not in TF_TOPICS:
                gaps.set_several(len(self.endpoints.publishers(topic)) > 1)
        if not self._truth.follow_type() and self._has_estimate and not self._has_truth:
            self.status.warn(self._truth.reason_for_silence(), "truth")

    def _receive(
        self,
        kind: type[Any],
        topic: str,
        callback: Callable[[Any], None],
        qos: QoSProfile,
        *,
        of_one_publisher: bool = True,
        on_first: Callable[[int], None] | None = None,
    ) -> Callable[[], object]:
        """Subscribe with a callback that is called in the worker's thread; return the function that unsubscribes.

        At the first message since the configuration, `on_first` is called in the worker's thread with the number of
        messages that were published before.
        """
        gaps = begin_counting(self._gaps, topic)
        gaps.set_several(not of_one_publisher)

        def received(message: Any, info: dict[str, Any]) -> None:  # noqa: ANN401 - any message
            gaps.add(info)
            if on_first is not None and gaps.count == 1:
                self.worker.enqueue(partial(on_first, gaps.before))
            size_bytes = len(message.data) if kind is PointCloud2 else 0
            sender = topic, (kind, gaps.returns)

            def handle() -> None:
                self._sender = sender
                callback(message)

            self.worker.enqueue_droppable(handle, size_bytes)

        return self.endpoints.add_subscription(kind, topic, received, qos, of_one_publisher=of_one_publisher)

    def _on_image_info(self, message: CameraInfo) -> None:
        """Add the stamp of an image. Losses are not counted, because the stamps are used only without an estimate."""
        if (stamp_ns := stamp_of(message)) > 0:
            self.worker.enqueue_droppable(partial(self._add_image, stamp_ns))

    # ---- in the worker's thread

    def _set_missed_estimates(self, count: int) -> None:
        self._missed_estimates = count

    def _add_image(self, stamp_ns: int) -> None:
        self._score.add_image(stamp_ns)
        self._note_stamp(stamp_ns)

    def _on_estimate(self, message: Odometry) -> None:
        stamp_ns, position, quat = odometry_row(message)
        covariance = covariance_of(message)

        def add() -> None:
            self._score.add_estimate(stamp_ns, position, quat, covariance)
            self._has_estimate = True
            self._note(stamp_ns)

        self._add_in_order(ESTIMATES, stamp_ns, add)

    def _add_truth(self, rows: list[TrueRow]) -> None:
        for row in rows:
            self._add_in_order(TRUTH, row[0], partial(self._add_true_pose, row))

    def _add_true_pose(self, row: TrueRow) -> None:
        stamp_ns, pose, variances = row
        self._score.add_truth(stamp_ns, pose[:3], pose[3:], np.array(variances))
        self._has_truth = True
        self._note(stamp_ns)

    def _add_in_order(self, source: str, stamp_ns: int, add: Callable[[], None]) -> None:
        """Add a pose or call once its run is known; strays and results of the previous run are dropped."""
        sender = self._sender

        def add_of_sender() -> None:
            self._note_publisher(*sender)
            add()

        accepted, begins_run = self._runs.add(source, stamp_ns, add_of_sender)
        if begins_run:
            self.get_logger().warning(f"the stamps of {SOURCES[source]} have jumped: the score restarts")
            self._begin_run("a new run")
            self._restarts += 1
        for add_item in accepted:
            add_item()

    def _begin_run(self, cause: str) -> None:
        """Discard what was received in the previous run."""
        self._discard(cause)
        self._score.restart()
        self._senders = {}
        self._is_truth_of_item = False
        self._missed_estimates = 0
        self._last_ns = 0

    def _discard(self, cause: str) -> None:
        """Record the interval of the data that are about to be discarded, if there are any."""
        if self._received_ns is not None:
            self._discards += 1
            self._discarded = (*self._discarded, DiscardedInterval(*self._received_ns, cause))[-MAX_LISTED:]
        self._received_ns = None

    def _on_call(self, task: Task, message: String) -> None:
        call = decode_call(message.data, task)

        def add() -> None:
            self._score.add_call(call)
            self._score_maps()
            self._note(call.stamp_ns)

        # Mapper calls of different states may have the same stamp, so each state is a source.
        source = task if task is Task.LOCALISATION else call.state
        self._add_in_order(source, call.stamp_ns, add)

    def _on_pose(self, message: PoseStamped) -> None:
        stamp_ns = stamp_of(message)
        pose = transform_from_pose(message.pose, f"nav/pose of stamp {stamp_ns}")

        def add() -> None:
            self._score.map_inputs.add_pose(stamp_ns, pose)
            self._note_stamp(stamp_ns)
            self._score_maps()

        self._add_in_order(NAV_POSE, stamp_ns, add)

    def _on_camera_info(self, side: Side, message: CameraInfo) -> None:
        if (both := self._camera_infos.add(side, message)) is None:
            return
        self._score.map_inputs.set_rig(rig_of_infos(both, "nav", raw=False)[0])
        while self._early_points:  # separate jobs, because each message may be unusable
            self.worker.enqueue(partial(self._on_true_points, self._early_points.popleft()))
        self._score_maps()

    def _on_true_points(self, message: PointCloud2) -> None:
        rig = self._score.map_inputs.rig
        if rig is None:
            self._early_points.append(message)
            return
        points = points_image(message, (rig.width, rig.height))
        self._score.map_inputs.add_true_points(stamp_of(message), points)
        self._score_maps()

    def _on_cloud(self, message: PointCloud2) -> None:
        self._note_publisher(*self._sender)
        self._score.map_inputs.add_cloud(stamp_of(message), cloud_from_msg(message))
        self._score_maps()

    def _on_configuration(self, task: Task, message: String) -> None:
        if len(message.data) > MAX_TEXT_BYTES:  # the configuration becomes part of every report
            raise InputError(
                f"{configuration_topic(task)} has {len(message.data)} characters: at most {MAX_TEXT_BYTES} are "
                "allowed; the message is ignored"
            )
        try:
            found = parse_json(message.data)
        except ValueError as error:
            raise InputError(f"{configuration_topic(task)} is not JSON ({error}): ignored") from error
        if not isinstance(found, dict):
            raise InputError(f"{configuration_topic(task)} is not a JSON object of parameters: ignored")
        self._configurations[task] = found

    def _score_maps(self) -> None:
        if self._score.score_maps():
            self._changed = self._unsaved = True

    def _note(self, stamp_ns: int) -> None:
        self._changed = self._unsaved = True
        self._last_ns = max(self._last_ns, stamp_ns)
        self._note_stamp(stamp_ns)
        self.status.note_arrival()

    def _note_publisher(self, topic: str, publisher: Sender) -> None:
        """Add a publisher to those of a scored topic in the run, unless the topic may have several publishers."""
        if topic not in TF_TOPICS:
            self._senders.setdefault(topic, set()).add(publisher)

    def _examine_truth(self) -> None:
        """Note publishers of the ground truth whose messages are not received, and a publisher that is also the item's.

        The graph is examined whenever a score is computed, because a publisher may exist only for a part of the run.
        """
        for kind in self._truth.types_beside():
            self._note_publisher(TRUE_POSES, (kind, 0))
        of_estimates = participants_of(self, self.resolve_topic_name(ESTIMATE))
        self._is_truth_of_item |= bool(of_estimates & self._truth.participants())

    def _note_stamp(self, stamp_ns: int) -> None:
        """Extend the interval of the received data."""
        first_ns, last_ns = self._received_ns or (stamp_ns, stamp_ns)
        self._received_ns = min(first_ns, stamp_ns), max(last_ns, stamp_ns)

    def _result(self, *, details: bool = True, in_flight_s: float = 0.0) -> Score:
        """Return the score so far, with the configurations of the nodes. The score itself states its settings."""
        parameters = json.loads(self.config_json()).items()
        monitor = {name: value for name, value in parameters if not name.startswith(SCORE_PREFIX)}
        made = Provenance(version=__version__, configuration=self._configurations | {"monitor": monitor})
        dropped = sum(self.counts().values())
        self._examine_truth()
        live = LiveRun(
            in_flight_s=in_flight_s,
            details=details,
            dropped=dropped,
            restarts=self._restarts,
            discards=self._discards,
            discarded=self._discarded,
            missed_estimates=self._missed_estimates,
            publisher_changes={name: len(found) - 1 for name, found in self._senders.items() if len(found) > 1},
            is_truth_of_item=self._is_truth_of_item,
            repeated_truth=self._runs.repeated(TRUTH),
            provenance=made,
        )
        return self._score.result(live)

    def _publish_periodically(self) -> None:
        """Publish the figures if messages were received and `ScorePacing` allows."""
        if not self._changed or not self._pacing.is_due():
            return
        with self._pacing.measured():
            try:
                self._publish_score()
            except MetricsError as error:  # for example because the poses are of two runs
                self.status.error(str(error))

    def _publish_score(self) -> None:
        self._changed = False
        score = self._result(details=False, in_flight_s=IN_FLIGHT_S)
        self._publisher.publish(score, self._last_ns)
        problem = score.contradiction or copies_caveat(score)
        self.status.note_call(Level.WARN if problem else Level.OK, problem or "scoring")

    def _finish(self) -> str:
        self._publish_score()
        return "the figures are published"

    def _save(self) -> str:
        if self._score_file is None:
            raise InputError("the parameter save_file is empty: start the node with a path")
        path = self._score_file.save(to_json(self._result()))
        self._unsaved = False
        return str(path)

    def _autosave(self) -> None:
        if self._unsaved:
            self._warn_on_error(self._save)

    def _warn_on_error(self, action: Callable[[], object]) -> None:
        try:
            action()
        except SfrError as error:
            self.status.warn(str(error))

    def _reset(self) -> str:
        self._begin_run("~/reset")
        self._runs.restart()
        self._restarts = 0
        self._changed = True
        return "the score restarts"


main = partial(run, MonitorNode)
