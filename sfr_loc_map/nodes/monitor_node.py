"""The monitor node: scores a run while it goes on and publishes the figures.

Whatever comes is handed in order to the worker's thread, which alone touches the score.
"""

from __future__ import annotations

import json
import os
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import CameraInfo, PointCloud2
from std_msgs.msg import Float64, String

from sfr_loc_map import __version__
from sfr_loc_map.config import param
from sfr_loc_map.errors import InputError, SfrError
from sfr_loc_map.io.atomic import atomic_path
from sfr_loc_map.io.camera_info import rig_from_camera_info
from sfr_loc_map.io.image_codec import stamp_of
from sfr_loc_map.io.point_image import points_image
from sfr_loc_map.mapping.config import MAX_PAIRS
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.metrics.limits import FAIL, PASS, load_limits
from sfr_loc_map.metrics.results import to_json
from sfr_loc_map.nodes.diagnostics.call_reporter import task_record
from sfr_loc_map.nodes.diagnostics.key_values import TOPIC, Level, Value, array_msg, status_msg
from sfr_loc_map.nodes.lifecycle.managed_node import ManagedNode, NodeConfig
from sfr_loc_map.nodes.lifecycle.worker import Overload
from sfr_loc_map.nodes.messages.fields import header_msg
from sfr_loc_map.nodes.messages.point_cloud import cloud_from_msg
from sfr_loc_map.nodes.messages.pose import odometry_row, transform_from_pose
from sfr_loc_map.nodes.process.runner import configure_malloc, run
from sfr_loc_map.pipeline.online.monitor_score import MonitorScore, warm_up
from sfr_loc_map.pipeline.online.transport_gaps import TransportGaps

NAME = "monitor_node"
FIGURES = {
    "position": ("trajectory", "position_m"),
    "attitude": ("trajectory", "attitude_deg"),
    "heading": ("trajectory", "heading_deg"),
    "point": ("map", "point_error_m"),
}
"""Topics below `metrics/` and where in the score their figures are."""
STATISTICS = ("mean", "sigma", "mean_plus_3sigma")
VERDICT_LEVELS = {PASS: Level.OK, FAIL: Level.ERROR}


@dataclass(frozen=True, slots=True)
class MonitorNodeConfig(NodeConfig):
    """Parameters of the monitor node."""

    publish_period_s: float = param(
        1.0, unit="s", doc="How often figures are published, if anything has come.", low=0.05, high=3600.0
    )
    limits_file: str = param("", doc="YAML file with limits to judge by; empty for none.")
    save_file: str = param("", doc="JSON file that ~/save writes the report to.")
    save_period_s: float = param(
        0.0,
        unit="s",
        doc="How often the report is saved without being asked, if anything has come, so that little is lost with the "
        "process; one that is there at the start is kept as *.before.json. 0: only when asked.",
        low=0.0,
        high=3600.0,
    )
    input_depth: int = param(1000, unit="messages", doc="Depth of the queues of poses and calls.", low=1, high=100000)
    score: ScoreConfig = field(default_factory=ScoreConfig)


class MonitorNode(ManagedNode):
    """Listens to estimates, truth, clouds and calls and publishes the score."""

    def __init__(self, name: str = NAME, **options: Any) -> None:  # noqa: ANN401
        """Declare the parameters.

        Args:
            name: Name of the node.
            options: Of `rclpy.node.Node`.

        Raises:
            ConfigError: If a parameter is unknown or not valid.
        """
        super().__init__(name, "monitor", MonitorNodeConfig, live=(), **options)
        self.free()

    def make(self) -> None:
        """Read the limits, warm up, advertise.

        Raises:
            ConfigError: If the file of limits is not valid.
        """
        config: MonitorNodeConfig = self.config
        limits = load_limits(Path(config.limits_file)) if config.limits_file else None
        warm_up(config.score)
        self._score = MonitorScore(config.score, limits)
        self._metrics = self.publish_on(DiagnosticArray, "metrics", 10)
        self._report = self.publish_on(String, "metrics/report", 1, latched=True)
        self._figures = {
            (name, statistic): self.publish_on(Float64, f"metrics/{name}/{statistic}", 10)
            for name in FIGURES
            for statistic in STATISTICS
        }

    def listen(self) -> None:
        """Subscribe and offer services."""
        many = QoSProfile(depth=self.config.input_depth)
        few = QoSProfile(depth=10)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        inputs: list[tuple[type[Any], str, Callable[[Any], None], QoSProfile]] = [
            (Odometry, "localisation/odometry", self._on_estimate, many),
            (Odometry, "ground_truth/odometry", self._on_truth, many),
            (DiagnosticArray, TOPIC, self._on_calls, many),
            (PoseStamped, "nav/pose", self._on_pose, many),
            (CameraInfo, "nav/left/camera_info", lambda message: self._on_info("left", message), few),
            (CameraInfo, "nav/right/camera_info", lambda message: self._on_info("right", message), few),
            (PointCloud2, "ground_truth/points", self._on_true_points, few),
            (PointCloud2, "mapping/points", self._on_cloud, few),
            (
                String,
                "localisation/configuration",
                lambda message: self._on_configuration("localisation", message),
                latched,
            ),
            (String, "mapping/configuration", lambda message: self._on_configuration("mapping", message), latched),
        ]
        for kind, topic, callback, qos in inputs:
            self.listen_to(kind, topic, self._handed_over(kind, callback), qos)
        self.offer("~/save", self._save)
        self.offer("~/reset", self._reset)
        self.every(self.config.publish_period_s, lambda: self.worker.put(self._publish))
        if self.config.save_file and self.config.save_period_s:
            self._keep_before()
            self.every(self.config.save_period_s, lambda: self.worker.put(self._autosave))

    def free(self) -> None:
        """Forget everything."""
        self._score = MonitorScore(self.config.score, None)
        self._gaps: list[TransportGaps] = []
        self._infos: dict[str, CameraInfo] = {}
        self._early_points: deque[PointCloud2] = deque(maxlen=MAX_PAIRS)
        self._configurations: dict[str, Any] = {}
        self._changed = self._unsaved = False
        self._last_ns = 0

    def queue_limits(self) -> tuple[Overload, int]:
        """Return that every message counts, as far as there is room."""
        return "every_pair", self.config.input_depth

    def counts(self) -> dict[str, int]:
        """Return what was dropped since the start, by name."""
        return {"dropped_in_transport": sum(gaps.lost for gaps in self._gaps)} | super().counts()

    # ---- in the executor's thread

    def _handed_over(self, kind: type[Any], callback: Callable[[Any], None]) -> Callable[..., None]:
        """Return a callback that lets the worker do the work, and report bad messages."""
        gaps = TransportGaps()
        if kind is not DiagnosticArray:  # which has many publishers
            self._gaps.append(gaps)

        def work(message: Any) -> None:  # noqa: ANN401 - any message
            try:
                callback(message)
            except SfrError as error:
                self.report_problem(str(error))

        def received(message: Any, info: dict[str, Any]) -> None:  # noqa: ANN401 - any message
            gaps.came(info)
            self.worker.offer(partial(work, message))

        return received

    # ---- in the worker's thread

    def _on_estimate(self, message: Odometry) -> None:
        stamp_ns, position, quat = odometry_row(message)
        self._restart_if_back("estimate", stamp_ns)
        covariance = np.array(message.pose.covariance, np.float64).reshape(6, 6)
        self._score.add_estimate(stamp_ns, position, quat, covariance)
        self._note(stamp_ns)

    def _on_truth(self, message: Odometry) -> None:
        stamp_ns, position, quat = odometry_row(message)
        self._restart_if_back("truth", stamp_ns)
        self._score.add_truth(stamp_ns, position, quat)
        self._note(stamp_ns)

    def _restart_if_back(self, kind: str, stamp_ns: int) -> None:
        if self._score.goes_back(kind, stamp_ns):
            self.get_logger().warning(f"stamps of the {kind} have gone back: the score starts anew")
            self._score.restart()

    def _on_calls(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if not self._is_ours(status):
                continue
            found = task_record(status)
            if found is not None:
                self._score.add_call(found.record)
                self._score.score_maps()
                self._note(found.record.stamp_ns)

    def _is_ours(self, status: DiagnosticStatus) -> bool:
        """Tell whether a status comes from a node of this namespace; /diagnostics is one for all."""
        namespace = self.get_namespace().strip("/")
        return bool(status.name.split(":")[0].rpartition("/")[0] == namespace)

    def _on_pose(self, message: PoseStamped) -> None:
        stamp_ns = stamp_of(message)
        self._score.add_pose(stamp_ns, transform_from_pose(message.pose, f"nav/pose of stamp {stamp_ns}"))
        self._try_maps()

    def _on_info(self, side: str, message: CameraInfo) -> None:
        self._infos[side] = message
        if len(self._infos) == 2:
            self._score.set_rig(rig_from_camera_info(self._infos["left"], self._infos["right"], "nav"))
            while self._early_points:
                self._on_true_points(self._early_points.popleft())
            self._try_maps()

    def _on_true_points(self, message: PointCloud2) -> None:
        rig = self._score.rig
        if rig is None:
            self._early_points.append(message)
            return
        self._score.add_true_points(stamp_of(message), points_image(message, rig))
        self._try_maps()

    def _on_cloud(self, message: PointCloud2) -> None:
        self._score.add_cloud(stamp_of(message), cloud_from_msg(message))
        self._try_maps()

    def _on_configuration(self, task: str, message: String) -> None:
        try:
            self._configurations[task] = json.loads(message.data)
        except (ValueError, RecursionError) as error:
            raise InputError(f"{task}/configuration is not JSON ({error}): ignored") from error

    def _try_maps(self) -> None:
        self._changed |= self._score.score_maps()

    def _note(self, stamp_ns: int) -> None:
        self._changed = self._unsaved = True
        self._last_ns = max(self._last_ns, stamp_ns)
        self.health.arrived()

    def _result(self, *, details: bool = True) -> dict[str, Any]:
        """Return the score so far, with the configurations that it was made with."""
        configuration = self._configurations | {"monitor": json.loads(self.configuration)}
        return self._score.result(details=details) | {
            "provenance": {"version": __version__, "configuration": configuration}
        }

    def _publish(self) -> None:
        if not self._changed:
            return
        self._changed = False
        begin = time.perf_counter()
        score = self._result(details=False)
        self._report.publish(String(data=to_json(score)))
        for (name, statistic), publisher in self._figures.items():
            part, figure = FIGURES[name]
            value = score.get(part, {}).get(figure, {}).get(statistic)
            if value is not None:
                publisher.publish(Float64(data=float(value)))
        self._metrics.publish(array_msg(header_msg(self._last_ns, ""), *metric_statuses(score)))
        self.health.called(Level.OK, "scoring", {"processing_time_s": time.perf_counter() - begin}, {})

    def _save(self) -> str:
        path = Path(self.config.save_file)
        if not self.config.save_file:
            raise InputError("the parameter save_file is empty: start the node with a path")
        with atomic_path(path) as temporary:
            temporary.write_text(to_json(self._result()), encoding="utf-8")
        return str(path)

    def _keep_before(self) -> None:
        """Give the report of a run before another name: it may be all that is left of it."""
        path = Path(self.config.save_file)
        try:
            if path.exists():
                os.replace(path, path.with_name(f"{path.stem}.before{path.suffix}"))
        except OSError as error:
            self.warn(f"cannot keep '{path}' of the run before: {error.strerror}")

    def _autosave(self) -> None:
        if not self._unsaved:
            return
        try:
            self._save()
        except SfrError as error:
            self.warn(str(error))
        else:
            self._unsaved = False

    def _reset(self) -> str:
        self._score.restart()
        self._changed = True
        return "the score starts anew"


def metric_statuses(score: dict[str, Any]) -> list[DiagnosticStatus]:
    """Return a score as diagnostics: one status for each group of figures, one for each verdict as its level."""
    statuses = []
    for part in ("trajectory", "map", "timing", "memory"):
        content = score.get(part, {})
        plain: dict[str, Value] = {k: v for k, v in content.items() if isinstance(v, (int, float, str))}
        if plain:
            statuses.append(status_msg(part, Level.OK, "", plain))
        for name, figure in content.items():
            if isinstance(figure, dict) and "mean" in figure:
                values = {k: v for k, v in figure.items() if isinstance(v, (int, float, str))}
                level = Level.OK if values.get("mean_plus_3sigma") is not None else Level.WARN
                statuses.append(status_msg(f"{part}/{name}", level, "" if values else "not enough data", values))
    for item in score.get("verdicts", []):
        values = {k: v for k, v in item.items() if isinstance(v, (int, float, str))}
        level = VERDICT_LEVELS.get(item["verdict"], Level.WARN)
        statuses.append(status_msg(f"verdict/{item['metric']}", level, item["verdict"], values))
    return statuses


def main() -> int:
    """Run the node."""
    configure_malloc()
    return run(MonitorNode)


if __name__ == "__main__":
    raise SystemExit(main())
