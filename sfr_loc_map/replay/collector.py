"""Collect the results that the nodes publish during a replay, and wait for them."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String
from std_srvs.srv import Trigger

from sfr_loc_map.calls.call_record import decode_call
from sfr_loc_map.errors import InputError, NodeError
from sfr_loc_map.message_stamps import stamp_of
from sfr_loc_map.message_types import StatusKind
from sfr_loc_map.replay.external import ExternalNode
from sfr_loc_map.replay.received import ReceivedResults
from sfr_loc_map.replay.replay_peer import ANSWER_TIMEOUT_S, ReplayPeer
from sfr_loc_map.ros.messages import cloud_from_msg, covariance_of, odometry_row
from sfr_loc_map.ros.peer import Unchanged
from sfr_loc_map.suite_names import Task
from sfr_loc_map.topics import CLOUD, DIAGNOSTICS, ESTIMATE, call_topic

QUEUE_DEPTH = 1000
QUIET_S = 5.0  #: Time for which the end of a replay waits for further results after the last one, s.


class ResultCollector:
    """Subscribes to the results of the nodes and waits for them."""

    def __init__(
        self,
        peer: ReplayPeer,
        results: ReceivedResults,
        external: ExternalNode | None,
        *,
        pairs_per_map: int,
        is_lock_step: bool,
    ) -> None:
        """Subscribe to the results of the suite's nodes, which are added to `results`."""
        self.results = results
        self._external = external
        self._pairs_per_map = pairs_per_map
        self._is_lock_step = is_lock_step
        self._peer = peer
        subscribe = peer.ros_node.create_subscription
        self._fault: NodeError | None = None  # first internal fault that a node of the suite reports
        self._input_error: InputError | None = None  # last unusable input that a node of the suite reports
        deep = QoSProfile(depth=QUEUE_DEPTH)
        if results.external_task is not Task.LOCALISATION:
            subscribe(Odometry, ESTIMATE, self._on_odometry, deep)
        if results.external_task is not Task.MAPPING:
            subscribe(PointCloud2, CLOUD, self._on_cloud, QoSProfile(depth=10))
        for task in Task:
            subscribe(String, call_topic(task), partial(self._on_call, task), deep)
        subscribe(DiagnosticArray, DIAGNOSTICS, self._on_diagnostics, deep)

    def note_sent(self, rig: str, stamp_ns: int, sent_s: float) -> None:
        """Note when the last image of a pair was published (monotonic clock); in lock step, wait for its results."""
        self.results.add_sent(rig, stamp_ns)
        if (external := self._external_of(rig)) is not None:
            external.note_sent(stamp_ns, sent_s)
        if self._is_lock_step:
            self.wait_for_pair(rig, stamp_ns)
        elif self._external is not None:
            self._external.check_process()
        self._check_nodes()

    def wait_for_pair(self, rig: str, stamp_ns: int) -> None:
        """Wait for the results of a pair of a replay in lock step.

        Raises the last unusable input that a node of the suite has reported, also before this pair, because in lock
        step no message may be lost. A replay at a rate continues after an unusable input.
        """
        if (external := self._external_of(rig)) is not None:
            external.wait_for(stamp_ns)
            return

        def is_complete() -> bool:
            self._check_nodes()
            if self._input_error is not None:
                raise self._input_error
            return self.results.has_pair(rig, stamp_ns)

        def problem() -> str:
            name = Task.of_rig(rig).node
            line = self._peer.supervisor.processes[name].last_log_line
            return f"{name} published no result for the pair of stamp {stamp_ns} (its last log line: {line})"

        self._peer.wait_for(is_complete, ANSWER_TIMEOUT_S, problem)

    def finish(self) -> None:
        """Wait for the missing results, finish a map in progress, and wait for the last map.

        Each wait for results ends if none has arrived for `QUIET_S`, so that lost pairs do not fail a replay at a rate.
        The wait for the answer of our mapper is longer, because nothing arrives during a fusion.
        """
        results = self.results
        self._wait_while_results_arrive(lambda: all(self._has_results(*pair) for pair in results.sent_pairs))
        if results.external_task is not Task.MAPPING and results.sent_stamps(Task.MAPPING.rig):
            self._finish_map()
        if self._external is not None:
            self._external.check_process()
        self._check_nodes()

    def close(self) -> None:
        """Add the answers and the process of an external node; called even if the replay has failed."""
        if self._external is not None:
            self.results.external = self._external.result()

    def _check_nodes(self) -> None:
        """Raise a NodeError if a node of the suite has ended or has reported an internal fault."""
        self._peer.supervisor.check()
        if self._fault is not None:
            raise self._fault

    def _external_of(self, rig: str) -> ExternalNode | None:
        """Return the external node if it processes the pairs of a rig; None if a node of the suite does."""
        return self._external if self.results.external_task is Task.of_rig(rig) else None

    def _has_results(self, rig: str, stamp_ns: int) -> bool:
        """Return whether the results of a pair are complete or no longer awaited."""
        external = self._external_of(rig)
        return self.results.has_pair(rig, stamp_ns) if external is None else external.is_settled(stamp_ns)

    def _finish_map(self) -> None:
        """Let our mapper finish a map in progress, and wait for the maps of the pairs that it received.

        The mapper answers after the pairs and fusions that it received earlier. The answer is a failure if no map is in
        progress, so that only a missing map of left pairs is an error.
        """
        problem = f"{Task.MAPPING.node} did not finish its map"
        answer = self._peer.request(Trigger, f"{Task.MAPPING.node}/finish", Trigger.Request(), problem)
        self._wait_while_results_arrive(self._has_all_maps)
        maps, left = divmod(len(self.results.mapped_stamps), self._pairs_per_map)
        if left and self.results.map_count <= maps and not answer.success:
            raise NodeError(f"{problem}: {answer.message}")

    def _has_all_maps(self) -> bool:
        """Return whether our mapper has published the results of all its pairs and their maps."""
        pairs = len(self.results.sent_stamps(Task.MAPPING.rig))
        maps = math.ceil(pairs / self._pairs_per_map)
        return len(self.results.mapped_stamps) == pairs and self.results.map_count >= maps

    def _wait_while_results_arrive(self, is_complete: Callable[[], bool]) -> None:
        """Wait until a condition holds, or until no result has arrived for `QUIET_S`."""
        unchanged = Unchanged()

        def is_over() -> bool:
            self._check_nodes()
            return is_complete() or unchanged.seconds(self.results.count) >= QUIET_S

        self._peer.spin(math.inf, is_over)

    def _on_odometry(self, message: Odometry) -> None:
        self.results.add_pose(odometry_row(message), covariance_of(message))

    def _on_call(self, task: Task, message: String) -> None:
        external = self._external_of(task.rig)
        try:
            call = decode_call(message.data, task)
        except InputError:
            if external is not None:
                return  # an external node need not report its calls
            raise
        if external is not None:
            external.note_call(call)
        self.results.add_call(task, call)

    def _on_cloud(self, message: PointCloud2) -> None:
        self.results.add_cloud(stamp_of(message), cloud_from_msg(message))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        """Note an unusable input or an internal fault that a node of the suite reports."""
        for status in message.status:
            node, _, kind = status.name.rpartition(": ")
            if node not in self._peer.supervisor.processes:
                continue
            if kind == StatusKind.INPUT:
                self._input_error = InputError(f"{node}: {status.message}")
            elif kind == StatusKind.FAULT and self._fault is None:
                self._fault = NodeError(f"{node}: {status.message}")
