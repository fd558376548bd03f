"""The waits of a replay for results: after each pair in lock step, and at the end of the source."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

from std_srvs.srv import Trigger

from sfr_loc_map.errors import NodeError
from sfr_loc_map.replay.collector import ResultCollector
from sfr_loc_map.replay.external import ExternalNode
from sfr_loc_map.replay.message_store import Received
from sfr_loc_map.replay.replay_peer import ANSWER_TIMEOUT_S, ReplayPeer
from sfr_loc_map.ros.peer import Unchanged
from sfr_loc_map.suite_names import Task

QUIET_S = 5.0  #: Time after the last result, s, for which the end of a replay waits for further results.


@dataclass(frozen=True, slots=True, eq=False)
class ResultWaits:
    """Waits for the results of published pairs, which `received` contains."""

    peer: ReplayPeer
    received: Received  #: Published pairs and received results.
    collector: ResultCollector
    external: ExternalNode | None
    pairs_per_map: int = field(kw_only=True)
    is_lock_step: bool = field(kw_only=True)

    def after_pair(self, task: Task, stamp_ns: int, sent_s: float) -> None:
        """Let an external node start its timeout, and wait for the results of a pair in lock step.

        `sent_s` is the time of the monotonic clock when the last image of the pair was published, s.
        """
        if (external := self._external_of(task)) is not None:
            external.note_sent(stamp_ns, sent_s)
        if self.is_lock_step:
            self._wait_for_pair(task, stamp_ns)
        elif self.external is not None:
            self.external.check_process()
        self.collector.check_nodes()

    def finish(self) -> None:
        """Wait for the missing results, finish a map in progress, and wait for the last map.

        Each wait for results ends if none has arrived for `QUIET_S`, so that lost pairs do not fail a replay
        that is not in lock step.
        An external node has at least its timeout for an answer. The wait for the answer of our mapper is longer,
        because nothing arrives during a fusion.
        """
        timeout_s = 0.0 if self.external is None else self.external.timeout_s
        self._wait_while_results_arrive(self._has_all_results, max(QUIET_S, timeout_s))
        if self.received.external_task is not Task.MAPPING and self.received.maps.sent_ns:
            self._finish_map()
        if self.external is not None:
            self.external.check_process()
        self.collector.check_nodes()

    def _wait_for_pair(self, task: Task, stamp_ns: int) -> None:
        """Wait for the results of a pair of a replay in lock step.

        Raises the last unusable input that a node of the suite has reported, also before this pair, because in lock
        step no message may be lost. A replay at a rate continues after an unusable input.
        """
        if (external := self._external_of(task)) is not None:
            external.wait_for(stamp_ns)
            return

        def is_complete() -> bool:
            self.collector.check_nodes()
            self.collector.check_inputs()
            return self.received.of(task).has_pair(stamp_ns)

        def problem() -> str:
            line = self.peer.supervisor.processes[task.node].last_log_line
            return f"{task.node} published no result for the pair of stamp {stamp_ns} (its last log line: {line})"

        self.peer.wait_for(is_complete, ANSWER_TIMEOUT_S, problem)

    def _external_of(self, task: Task) -> ExternalNode | None:
        """Return the external node if it has the task; None if a node of the suite does."""
        return self.external if task is self.received.external_task else None

    def _has_all_results(self) -> bool:
        """Return whether the results of all pairs are complete or no longer awaited."""
        return all(self._has_results(task, stamp_ns) for task in Task for stamp_ns in self.received.of(task).sent_ns)

    def _has_results(self, task: Task, stamp_ns: int) -> bool:
        external = self._external_of(task)
        return self.received.of(task).has_pair(stamp_ns) if external is None else external.is_settled(stamp_ns)

    def _finish_map(self) -> None:
        """Let our mapper finish a map in progress, and wait for the maps of the pairs that it received.

        The mapper answers after the pairs and fusions that it received earlier. The answer is a failure if no map is in
        progress, so that only a missing map of left pairs is an error.
        """
        problem = f"{Task.MAPPING.node} did not finish its map"
        answer = self.peer.request(Trigger, f"{Task.MAPPING.node}/finish", Trigger.Request(), problem)
        self._wait_while_results_arrive(self._has_all_maps, QUIET_S)
        maps, left = divmod(len(self.received.maps.mapped_ns), self.pairs_per_map)
        if left and self.received.maps.map_count <= maps and not answer.success:
            raise NodeError(f"{problem}: {answer.message}")

    def _has_all_maps(self) -> bool:
        """Return whether our mapper has published the results of all its pairs and their maps."""
        maps = self.received.maps
        pairs = len(maps.sent_ns)
        return len(maps.mapped_ns) == pairs and maps.map_count >= math.ceil(pairs / self.pairs_per_map)

    def _wait_while_results_arrive(self, is_complete: Callable[[], bool], quiet_s: float) -> None:
        """Wait until a condition holds, or until no result has arrived for `quiet_s`."""
        unchanged = Unchanged()

        def is_over() -> bool:
            self.collector.check_nodes()
            return is_complete() or unchanged.seconds(self.received.count) >= quiet_s

        self.peer.spin(math.inf, is_over)
