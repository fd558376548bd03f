"""Collects what the nodes publish during a replay, and waits for it."""

from __future__ import annotations

import json
import time
from functools import partial

from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String
from std_srvs.srv import Trigger

from sfr_loc_map.errors import InputError
from sfr_loc_map.inputs import Task, stamp_of
from sfr_loc_map.metrics.config import CallKind, MappingState
from sfr_loc_map.nodes import diagnostics
from sfr_loc_map.nodes.diagnostics import Level, level_of
from sfr_loc_map.nodes.messages import cloud_from_msg, covariance_of, odometry_row
from sfr_loc_map.nodes.peer import POLL_S
from sfr_loc_map.nodes.replay.external import ExternalNode
from sfr_loc_map.nodes.replay.graph_node import ANSWER_TIMEOUT_S, ReplayNode
from sfr_loc_map.nodes.replay.results import ReplayResults
from sfr_loc_map.pipeline.call_stats import decode_call

QUEUE_DEPTH = 1000
NODE_OF_TASK = {"loc": "localisation_node", "nav": "mapping_node"}
QUIET_S = 5.0  #: At a rate, results are awaited for so long after the last one.
REPORT_TIMEOUT_S = 60.0


class ResultCollector:
    """Subscribes to the results of the nodes and waits for them."""

    def __init__(self, node: ReplayNode, pairs_per_map: int, external: ExternalNode | None) -> None:
        """Subscribe; an external node in place of one of ours collects the results of its task itself."""
        self.results, self.external, self._pairs_per_map = ReplayResults(), external, pairs_per_map
        if external is not None:
            external.begin_run(self.results)
        other = None if external is None else external.options.task
        self._before: ReplayResults | None = None
        self._cut_short: list[ReplayResults] = []
        self._node, subscribe = node, node.node.create_subscription
        if other is not Task.LOCALISATION:
            subscribe(Odometry, "localisation/odometry", self._on_odometry, QoSProfile(depth=QUEUE_DEPTH))
        if other is not Task.MAPPING:
            subscribe(PointCloud2, "mapping/points", self._on_cloud, QoSProfile(depth=10))
        for task in Task:
            subscribe(String, f"{task}_node/call", partial(self._on_call, task), QoSProfile(depth=QUEUE_DEPTH))
        subscribe(DiagnosticArray, diagnostics.TOPIC, self._on_diagnostics, QoSProfile(depth=QUEUE_DEPTH))
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        subscribe(String, "metrics/report", self._on_report, latched)

    def published(self, task: str, stamp_ns: int, sent_s: float) -> None:
        """Note that a pair was published, its last image at a time of the monotonic clock."""
        self.results.published.add((task, stamp_ns))
        if (book := self.results.answers) is not None and task == book.task:
            book.published(stamp_ns, sent_s)

    def _external_of(self, task: str) -> ExternalNode | None:
        return self.external if self.external is not None and task == self.external.options.task.rig else None

    def wait_for_pair(self, task: str, stamp_ns: int) -> None:
        """Wait for the results of one pair."""
        if (external := self._external_of(task)) is not None:
            external.wait_for(stamp_ns)
            return

        def received() -> bool:
            if self.results.input_error:
                raise InputError(self.results.input_error)
            return self.results.has_pair(task, stamp_ns)

        def problem() -> str:
            name = NODE_OF_TASK[task]
            line = self._node.supervisor.processes[name].last_log_line
            return f"{name} gave no result for the pair of stamp {stamp_ns} (its last log line: {line})"

        self._node.wait_for(received, ANSWER_TIMEOUT_S, problem)

    def begin_run(self) -> None:
        """Collect the results of another run; those of the run before are kept, see `finish`."""
        if self.results.count and not self.results.whole:
            self._cut_short.append(self.results)
        self._before, self.results = self._to_be_scored(), ReplayResults()
        if self.external is not None:
            self.external.begin_run(self.results)

    def _to_be_scored(self) -> ReplayResults:
        """Return the last run that was played to its end, without one the last that has a result."""
        before, last = self._before, self.results
        return last if before is None or last.whole or (last.count and not before.whole) else before

    def settle(self, clouds: int = 0) -> None:
        """Wait for the results of all published pairs and so many clouds, as long as some are received."""
        results, count, deadline = self.results, -1, 0.0
        while count != results.count or time.monotonic() < deadline:
            if len(results.clouds) >= clouds and all(results.has_pair(*pair) for pair in results.published):
                return
            if count != results.count:
                count, deadline = results.count, time.monotonic() + QUIET_S
            self._node.spin_for(POLL_S)

    @property
    def whole_maps(self) -> int:
        """How many clouds our mapper makes of the pairs that were published."""
        return len(self.results.published_stamps("nav")) // max(self._pairs_per_map, 1)

    def finish(self, *, has_map_truth: bool) -> ReplayResults:
        """Wait for results still missing: pairs, cloud, report; return the last whole run, or else with results."""
        scored = self._to_be_scored()
        if scored is not self.results:
            self.settle()
            self.begin_run()
        else:
            mapped, clouds = self.results.published_stamps("nav"), self.whole_maps
            if self._external_of("nav") is not None:
                clouds = 0  # how many it gives is its own affair
            elif mapped and len(mapped) % self._pairs_per_map:
                for stamp_ns in mapped:
                    self.wait_for_pair("nav", stamp_ns)
                finish = self._node.node.create_client(Trigger, "mapping_node/finish")
                self._node.call(finish, "mapping_node did not finish its map")
                clouds += 1
            self.settle(clouds)
            report = self._node.node.create_client(Trigger, "monitor_node/finish")
            deadline = time.monotonic() + REPORT_TIMEOUT_S
            while not self._has_full_report(clouds > 0 and has_map_truth) and time.monotonic() < deadline:
                self._node.call(report, "monitor_node did not publish its figures")
                self._node.spin_for(POLL_S)
        scored.cut_short = tuple(run for run in self._cut_short if run is not scored)
        return scored

    def _has_full_report(self, with_map: bool) -> bool:
        """Tell whether the report has everything; without it the score is made of the results all the same."""
        results, report = self.results, json.loads(self.results.report or "{}")
        poses = report.get("trajectory", {}).get("estimate_poses", len(results.rows))
        timing = report.get("timing", {})
        calls = sum(timing.get(f"{kind}_s", {}).get("count", 0) for kind in CallKind)
        sets = sum(state == MappingState.MAPPED_SET for state, _ in results.mapping)  # told after their clouds
        done = calls >= len(results.localisation) + len(results.mapping)
        done &= self._external_of("nav") is not None or sets >= len(results.clouds)
        return done and poses >= len(results.rows) and ("map" in report or not with_map)

    def _on_odometry(self, message: Odometry) -> None:
        self.results.rows.append(odometry_row(message))
        self.results.covariances[stamp_of(message)] = covariance_of(message)

    def _on_call(self, task: Task, message: String) -> None:
        results, external = self.results, self.external
        is_external = external is not None and external.options.task is task
        try:
            call = decode_call(message.data, task)
        except InputError:
            if is_external:
                return  # what it publishes of its calls is optional
            raise
        if external is not None and is_external:
            external.version = call.version or external.version
        if task is Task.LOCALISATION:
            results.localisation[call.stamp_ns] = call
        else:
            results.mapping[call.state, call.stamp_ns] = call

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        """Note what one of our nodes reports of input that it cannot use."""
        for status in message.status:
            node, _, what = status.name.rpartition(": ")
            is_ours = node in self._node.supervisor.processes
            if level_of(status) is Level.ERROR and what == "input" and is_ours:
                self.results.input_error = f"{node}: {status.message}"

    def _on_cloud(self, message: PointCloud2) -> None:
        self.results.clouds.append((stamp_of(message), cloud_from_msg(message)))

    def _on_report(self, message: String) -> None:
        self.results.report = message.data
