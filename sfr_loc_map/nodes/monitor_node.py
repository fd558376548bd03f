"""The monitor node: scores a run in progress and publishes the figures.

All input is given to the worker in its order; its thread alone touches the score.
"""

from __future__ import annotations

import json
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, fields
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile
from sensor_msgs.msg import CameraInfo, PointCloud2
from std_msgs.msg import Float64, String

from sfr_loc_map import __version__
from sfr_loc_map.config import param
from sfr_loc_map.doctor.silence import Reliability, silence_of
from sfr_loc_map.errors import ConfigError, InputError, MetricsError, SfrError
from sfr_loc_map.geometry.rectification import rig_of_rectified
from sfr_loc_map.geometry.run_order import AnyOrder
from sfr_loc_map.inputs import MAX_TEXT_BYTES, SIDES, Side, Task, parse_json, stamp_of
from sfr_loc_map.io.images.codec import points_image
from sfr_loc_map.io.truth.config import LiveTruth
from sfr_loc_map.io.truth.messages import TRUTH_TYPES, TruePoses, TrueRow
from sfr_loc_map.mapping.config import MAX_PAIRS
from sfr_loc_map.message_types import Level
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.metrics.judging.limits_file import load_limits
from sfr_loc_map.metrics.records import Provenance
from sfr_loc_map.metrics.score import Score
from sfr_loc_map.metrics.score_json import to_json
from sfr_loc_map.nodes.input.camera_info_pair import CameraInfoPair
from sfr_loc_map.nodes.input.stereo_input import StereoInputConfig
from sfr_loc_map.nodes.input.truth_input import TruthFrame, TruthTopic
from sfr_loc_map.nodes.lifecycle.managed_node import ManagedNode
from sfr_loc_map.nodes.lifecycle.parameters import NodeConfig
from sfr_loc_map.nodes.lifecycle.runner import run
from sfr_loc_map.nodes.lifecycle.worker import Overload
from sfr_loc_map.nodes.report_file import ReportFile
from sfr_loc_map.nodes.ros.messages import (
    cloud_from_msg,
    covariance_of,
    header_msg,
    message_type,
    odometry_row,
    tf_message_type,
    transform_from_pose,
)
from sfr_loc_map.nodes.ros.publishers import publishers_of
from sfr_loc_map.nodes.ros.qos import LATCHED, RELIABILITIES, TF_STATIC_QOS, profile
from sfr_loc_map.nodes.ros.transport import TransportGaps
from sfr_loc_map.nodes.score_messages import figure_topics, score_statuses
from sfr_loc_map.runs.calls import decode_call
from sfr_loc_map.scoring.monitor_score import MonitorScore
from sfr_loc_map.topics import (
    CLOUD,
    ESTIMATE,
    METRICS,
    NAV_POSE,
    REPORT,
    TF,
    TF_STATIC,
    TRUE_POINTS,
    TRUE_POSES,
    call_topic,
    configuration_topic,
)

RESTS = 9.0  #: Time without scoring after each score, as a multiple of the processor time that it took.
DIAGNOSED_GROWTH = 1.2  #: A convention mismatch is looked for again once there are so many times the poses.
IN_FLIGHT_S = 5.0  #: While a run goes on, results of pairs that are younger than this do not count as missing.


@dataclass(frozen=True, slots=True)
class MonitorInputConfig:
    """How the monitor receives."""

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
        doc="Period at which figures are published if messages were received. The period is longer in a long run, so "
        "that at most a tenth of the time is spent on scoring.",
        low=0.05,
        high=3600.0,
    )
    limits_file: str = param("", doc="YAML file with limits. Empty: no limits.")
    save_file: str = param(
        "", doc="JSON file to which ~/save writes the report. An existing file must be a report; other files are kept."
    )
    save_period_s: float = param(
        0.0,
        unit="s",
        doc="Period at which the report is saved if messages were received, so that a crash loses little. A report "
        "that exists at the start is kept as *.before.json. 0: only by ~/save.",
        low=0.0,
        high=3600.0,
    )
    input: MonitorInputConfig = field(default_factory=MonitorInputConfig)
    score: ScoreConfig = field(default_factory=ScoreConfig)
    truth: LiveTruth = field(default_factory=LiveTruth)

    def queue(self) -> tuple[Overload, int]:
        """Return that every message counts, as far as there is room."""
        return Overload.ALL, self.input.queue_depth


class ScorePacing:
    """Limits scoring to a tenth of the processor time of its thread."""

    def __init__(self) -> None:
        """Begin; the first score is due."""
        self._rest_until_s = 0.0

    def is_due(self) -> bool:
        """Return whether the rest after the last score is over."""
        return time.perf_counter() >= self._rest_until_s

    @contextmanager
    def measured(self) -> Iterator[None]:
        """Rest after the `with` block in proportion to its processor time, without what others took of a busy host."""
        begin_s = time.thread_time()
        yield
        self._rest_until_s = time.perf_counter() + RESTS * (time.thread_time() - begin_s)


class MonitorNode(ManagedNode[MonitorNodeConfig]):
    """Receives estimates, truth, clouds and calls and publishes the score."""

    task = "monitor"
    config_type = MonitorNodeConfig
    names_of_others = tuple(f"input.{item.name}" for item in fields(StereoInputConfig))
    _truth_topic: TruthTopic | None
    _truth_frame: TruthFrame | None

    def setup(self) -> None:
        """Read the limits, create publishers."""
        config = self.config
        if config.limits_file:
            self._score.limits = load_limits(Path(config.limits_file))
        if config.truth.frame:
            self._truth_frame = TruthFrame(config.truth.frame)
        if self._report_file is not None:
            self._report_file.check()
        add_publisher = self.endpoints.add_publisher
        self._metrics = add_publisher(DiagnosticArray, METRICS, 10)
        self._report = add_publisher(String, REPORT, 1, latched=True)
        self._figures = {topic: add_publisher(Float64, topic, 10) for topic in figure_topics()}

    def subscribe(self) -> None:
        """Subscribe and offer services."""
        config = self.config
        deep, shallow = QoSProfile(depth=config.input.queue_depth), QoSProfile(depth=10)
        of_rover, info = (profile(config.input.reliability, depth) for depth in (config.input.queue_depth, 10))
        self._receive(Odometry, ESTIMATE, self._on_estimate, deep)
        if self._truth_frame is not None:
            self._receive_transforms(self._truth_frame, of_rover)
        else:
            self._truth_topic = TruthTopic(self._receive_truth)
        self._receive(PoseStamped, NAV_POSE, self._on_pose, of_rover)
        for side in SIDES:
            self._receive(CameraInfo, f"nav/{side}/camera_info", partial(self._on_camera_info, side), info)
        self._receive(PointCloud2, TRUE_POINTS, self._on_true_points, shallow)
        self._receive(PointCloud2, CLOUD, self._on_cloud, shallow)
        for task in Task:
            self._receive(String, call_topic(task), partial(self._on_call, task), deep)
            self._receive(String, configuration_topic(task), partial(self._on_configuration, task), LATCHED)
        self.add_service("~/save", self._save)
        self.add_service("~/finish", self._finish)
        self.add_service("~/reset", self._reset)
        self.endpoints.add_timer(config.publish_period_s, lambda: self.worker.enqueue(self._publish))
        if self._report_file is not None and config.save_period_s:
            self._warn_on_error(self._report_file.keep_previous)
            self.endpoints.add_timer(config.save_period_s, lambda: self.worker.enqueue(self._autosave))

    def reset_state(self) -> None:
        """Create the state of a run, without results."""
        config = self.config
        self._score = MonitorScore(config.score, None, config.truth)
        self._report_file = ReportFile(Path(config.save_file)) if config.save_file else None
        self._gaps: list[TransportGaps] = []
        self._camera_infos = CameraInfoPair()
        self._orders: dict[str, AnyOrder[tuple[int, Callable[[], None]]]] = {
            kind: AnyOrder() for kind in ("estimate", "truth")
        }
        self._truth_topic = self._truth_frame = None
        self._has_truth = False
        self._contradiction: str | None = None  # of the convention of estimate and truth
        self._diagnosed_poses = 0  # poses when it was looked for
        self._early_points: deque[PointCloud2] = deque(maxlen=MAX_PAIRS)
        self._configurations: dict[str, Any] = {}
        self._changed = self._unsaved = False
        self._pacing = ScorePacing()
        self._last_ns = 0

    def counts(self) -> dict[str, int]:
        """Return what was dropped since the start, by name."""
        dropped = {
            "dropped_in_transport": sum(gaps.lost for gaps in self._gaps),
            "dropped_stray": sum(order.strays for order in self._orders.values()) + self._stray_transforms(),
        }
        return dropped | super().counts()

    def _stray_transforms(self) -> int:
        return 0 if self._truth_frame is None else self._truth_frame.strays

    def look_around(self) -> None:
        """Log what was dropped, take a truth of another type, and say why nothing is scored."""
        super().look_around()
        if self._has_truth:
            return
        is_waiting = self._orders["estimate"].has_items
        if self._truth_topic is None:
            if is_waiting:
                frame = self.config.truth.frame
                self.status.warn(f"nothing is scored without the transforms {frame} on /tf: publish them", "truth")
            return
        topic = self.resolve_topic_name(TRUE_POSES)
        publishers = publishers_of(self, topic)
        if self._truth_topic.follow([publisher.msgtype for publisher in publishers]):
            self.get_logger().info(f"{TRUE_POSES} is {self._truth_topic.msgtype}: true poses are read from it")
        elif is_waiting:
            found = silence_of(topic, tuple(TRUTH_TYPES), publishers, Reliability(self.config.input.reliability))
            text = f"nothing is scored without true poses on {topic}: {found.text}; {found.fix}"
            self.status.warn(text, "truth")

    def _receive_truth(self, msgtype: str) -> Callable[[], object]:
        """Subscribe to true poses of a type; return what ends that."""
        on_truth = partial(self._on_truth, TruePoses(msgtype))
        qos = profile(self.config.input.reliability, self.config.input.queue_depth)
        return self._receive(message_type(msgtype), TRUE_POSES, on_truth, qos)

    def _receive_transforms(self, reader: TruthFrame, qos: QoSProfile) -> None:
        """Subscribe to /tf and /tf_static, which have several publishers each."""
        kind = tf_message_type()
        if kind is None:
            raise ConfigError("truth.frame: tf2_msgs for /tf is not installed: install ros-jazzy-tf2-msgs")
        for topic, wanted in ((TF_STATIC, TF_STATIC_QOS), (TF, qos)):
            on_transforms = partial(self._on_transforms, reader, is_static=topic == TF_STATIC)
            self._receive(kind, topic, on_transforms, wanted, has_several_publishers=True)

    def _receive(
        self,
        kind: type[Any],
        topic: str,
        callback: Callable[[Any], None],
        qos: QoSProfile,
        *,
        has_several_publishers: bool = False,
    ) -> Callable[[], object]:
        """Subscribe with a callback that is called in the worker's thread; return what ends that."""
        gaps = TransportGaps()
        gaps.set_several(has_several_publishers)
        self._gaps.append(gaps)

        def received(message: Any, info: dict[str, Any]) -> None:  # noqa: ANN401 - any message
            gaps.add(info)
            size_bytes = len(message.data) if kind is PointCloud2 else 0
            self.worker.enqueue_droppable(partial(callback, message), size_bytes)

        return self.endpoints.add_subscription(kind, topic, received, qos)

    # ---- in the worker's thread

    def _on_estimate(self, message: Odometry) -> None:
        stamp_ns, position, quat = odometry_row(message)
        covariance = covariance_of(message)
        self._add_in_order("estimate", stamp_ns, lambda: self._score.add_estimate(stamp_ns, position, quat, covariance))

    def _on_truth(self, reader: TruePoses, message: Any) -> None:  # noqa: ANN401 - of one of TRUTH_TYPES
        self._add_truth(reader.rows(message))

    def _on_transforms(self, reader: TruthFrame, message: Any, *, is_static: bool) -> None:  # noqa: ANN401 - of tf2_msgs
        self._add_truth(reader.rows(message, is_static=is_static))

    def _add_truth(self, rows: list[TrueRow]) -> None:
        for stamp_ns, pose, variances in rows:
            add = partial(self._score.add_truth, stamp_ns, pose[:3], pose[3:], np.array(variances))
            self._add_in_order("truth", stamp_ns, add)

    def _add_in_order(self, kind: str, stamp_ns: int, add: Callable[[], None]) -> None:
        """Add a pose once its run is known; strays and results of the run before are dropped."""
        if self._score.is_late(kind, stamp_ns):
            return
        ready, begins_run = self._orders[kind].add(stamp_ns, (stamp_ns, add))
        added = [(kind, *item) for item in ready]
        if begins_run:
            self.get_logger().warning(f"stamps of the {kind} have gone to another time: the score restarts")
            self._score.restart(kind, ready[0][0])
            for other, order in self._orders.items():
                added += [(other, *item) for item in (order.release() if other != kind else ())]
        for each, at_ns, add_pose in added:
            self._score.note_stamp(each, at_ns)
            add_pose()
            self._has_truth = self._has_truth or each == "truth"
            self._note(at_ns)

    def _on_call(self, task: Task, message: String) -> None:
        call = decode_call(message.data, task)
        self._score.add_call(call)
        self._score_maps()
        self._note(call.stamp_ns)

    def _on_pose(self, message: PoseStamped) -> None:
        stamp_ns = stamp_of(message)
        pose = transform_from_pose(message.pose, f"nav/pose of stamp {stamp_ns}")
        self._score.map_inputs.add_pose(stamp_ns, pose)
        self._score_maps()

    def _on_camera_info(self, side: Side, message: CameraInfo) -> None:
        if (both := self._camera_infos.add(side, message)) is None:
            return
        self._score.map_inputs.rig = rig_of_rectified(both, "nav")[0]
        while self._early_points:
            self._on_true_points(self._early_points.popleft())
        self._score_maps()

    def _on_true_points(self, message: PointCloud2) -> None:
        rig = self._score.map_inputs.rig
        if rig is None:
            self._early_points.append(message)
            return
        self._score.map_inputs.true_points[stamp_of(message)] = points_image(message, (rig.width, rig.height))
        self._score_maps()

    def _on_cloud(self, message: PointCloud2) -> None:
        self._score.map_inputs.clouds[stamp_of(message)] = cloud_from_msg(message)
        self._score_maps()

    def _on_configuration(self, task: Task, message: String) -> None:
        if len(message.data) > MAX_TEXT_BYTES:  # it becomes part of every report
            raise InputError(f"{task}/configuration has {len(message.data)} characters: ignored")
        try:
            found = parse_json(message.data)
        except ValueError as error:
            raise InputError(f"{task}/configuration is not JSON ({error}): ignored") from error
        if not isinstance(found, dict):
            raise InputError(f"{task}/configuration is not a JSON object of parameters: ignored")
        self._configurations[task] = found

    def _score_maps(self) -> None:
        if self._score.score_maps():
            self._changed = self._unsaved = True

    def _note(self, stamp_ns: int) -> None:
        self._changed = self._unsaved = True
        self._last_ns = max(self._last_ns, stamp_ns)
        self.status.note_arrival()

    def _result(self, *, details: bool = True, in_flight_s: float = 0.0) -> Score:
        """Return the score so far, with the configurations that it was made with."""
        configuration = self._configurations | {"monitor": json.loads(self.config_json())}
        made = Provenance(version=__version__, configuration=configuration)
        self._score.dropped = sum(self.counts().values())
        if self._score.poses >= DIAGNOSED_GROWTH * self._diagnosed_poses or self._score.poses < self._diagnosed_poses:
            self._diagnosed_poses = self._score.poses
            self._contradiction = self._score.contradiction()
        contradiction = self._contradiction
        return self._score.result(made, details=details, in_flight_s=in_flight_s, contradiction=contradiction)

    def _publish(self) -> None:
        """Publish the figures; a long run is scored less often, at most a tenth of the time."""
        if not self._changed or not self._pacing.is_due():
            return
        self._changed = False
        begin = time.perf_counter()
        with self._pacing.measured():
            self._publish_score(begin)

    def _publish_score(self, begin: float) -> None:
        try:
            score = self._result(details=False, in_flight_s=IN_FLIGHT_S)
        except MetricsError as error:  # two runs in one, for instance
            self.status.error(str(error))
            return
        self._report.publish(String(data=to_json(score)))
        for topic, (figure, statistic) in figure_topics().items():
            value = score.number(figure, statistic)
            if value is not None:
                self._figures[topic].publish(Float64(data=float(value)))
        header = header_msg(self._last_ns, "")
        self._metrics.publish(DiagnosticArray(header=header, status=score_statuses(score)))
        level, state = (Level.OK, "scoring") if score.contradiction is None else (Level.WARN, score.contradiction)
        self.status.note_call(level, state, {"processing_time_s": time.perf_counter() - begin}, {})

    def _finish(self) -> str:
        self._changed, self._pacing = True, ScorePacing()
        self._publish()
        return "the figures are published"

    def _save(self) -> str:
        if self._report_file is None:
            raise InputError("the parameter save_file is empty: start the node with a path")
        path = self._report_file.save(to_json(self._result()))
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
        self._score.restart()
        for order in self._orders.values():
            order.restart()
        self._changed = True
        return "the score restarts"


main = partial(run, MonitorNode)
