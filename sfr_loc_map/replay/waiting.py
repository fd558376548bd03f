"""The waits of a replay for results: after each pair in lock step, and at the end of the source.

A replay awaits the results of each task from one node: a node of the suite (`OurNode`, `OurMapper`), or the external
node under test (`external.external_node`).
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass

from std_srvs.srv import Trigger

from sfr_loc_map.errors import NodeError
from sfr_loc_map.replay.collector import ResultCollector
from sfr_loc_map.replay.replay_peer import ANSWER_TIMEOUT_S
from sfr_loc_map.suite_names import Task

QUIET_S = 5.0
"""Time without a result, s, after which a replay at its end no longer waits for missing results. Chosen above the
interval between two results on a busy host, which is several seconds."""


class AwaitedNode(ABC):
    """The node of a task, from which a replay awaits the results of its pairs."""

    @property
    def quiet_s(self) -> float:
        """Time without any result, s, after which missing results of the node are no longer awaited."""
        return QUIET_S

    @abstractmethod
    def wait_for(self, stamp_ns: int) -> None:
        """Wait in lock step for the results of a pair."""

    @abstractmethod
    def is_settled(self, stamp_ns: int) -> bool:
        """Return whether the results of a pair are complete, or no longer awaited."""

    @abstractmethod
    def check(self) -> None:
        """Check whether the node runs."""

    def note_sent(self, stamp_ns: int, sent_s: float) -> None:  # noqa: B027 - a node need not note anything
        """Note a pair, and the time of the monotonic clock when its last image was published, s."""

    def finish(self) -> None:  # noqa: B027 - as above
        """Wait for results that do not belong to one pair, after the results of all pairs are settled."""


@dataclass(frozen=True)
class OurNode(AwaitedNode):
    """A node of the suite, whose end or internal fault ends the replay."""

    task: Task
    collector: ResultCollector

    def wait_for(self, stamp_ns: int) -> None:
        """Wait in lock step for the results of a pair.

        Raises the last unusable input that a node of the suite has reported, also before this pair, because in lock
        step no message may be lost. A replay at a rate continues after an unusable input.
        """
        peer = self.collector.peer

        def is_complete() -> bool:
            self.collector.check_nodes()
            self.collector.check_inputs()
            return self.is_settled(stamp_ns)

        def problem() -> str:
            line = peer.supervisor.processes[self.task.node].last_log_line
            return f"{self.task.node} published no result for the pair of stamp {stamp_ns} (its last log line: {line})"

        peer.wait_for(is_complete, ANSWER_TIMEOUT_S, problem)

    def is_settled(self, stamp_ns: int) -> bool:
        """Return whether the results of a pair were received."""
        return self.collector.received.of(self.task).has_pair(stamp_ns)

    def check(self) -> None:
        """Raise a NodeError if a node of the suite has ended or has reported an internal fault."""
        self.collector.check_nodes()


@dataclass(frozen=True)
class OurMapper(OurNode):
    """The mapper of the suite, which publishes a map after `pairs_per_map` pairs or at the service `~/finish`."""

    pairs_per_map: int

    def finish(self) -> None:
        """Let the mapper finish a map in progress, and wait for the maps of the pairs that it received.

        The mapper answers after the pairs and fusions that it received earlier. The answer is a failure if no map is in
        progress, so that only a missing map of the remaining pairs is an error.
        """
        maps = self.collector.received.maps
        if not maps.sent_ns:
            return
        problem = f"{self.task.node} did not finish its map"
        answer = self.collector.peer.request(Trigger, f"{self.task.node}/finish", Trigger.Request(), problem)
        self.collector.wait_while_results_arrive(self._has_all_maps, QUIET_S)
        complete_maps, remaining_pairs = divmod(len(maps.mapped_ns), self.pairs_per_map)
        if remaining_pairs and maps.map_count <= complete_maps and not answer.success:
            raise NodeError(f"{problem}: {answer.message}")

    def _has_all_maps(self) -> bool:
        """Return whether the mapper has published the results of all its pairs and their maps."""
        maps = self.collector.received.maps
        pairs = len(maps.sent_ns)
        return len(maps.mapped_ns) == pairs and maps.map_count >= math.ceil(pairs / self.pairs_per_map)


@dataclass(frozen=True, slots=True)
class ResultWaits:
    """Waits for the results of published pairs, which the collector has received."""

    collector: ResultCollector
    nodes: Mapping[Task, AwaitedNode]  #: The node of each task.
    is_lock_step: bool

    def after_pair(self, task: Task, stamp_ns: int, sent_s: float) -> None:
        """Note a published pair, and wait for its results in lock step.

        `sent_s` is the time of the monotonic clock when the last image of the pair was published, s.
        """
        node = self.nodes[task]
        node.note_sent(stamp_ns, sent_s)
        if self.is_lock_step:
            node.wait_for(stamp_ns)
        self._check_nodes()

    def finish(self) -> None:
        """Wait for the missing results of all pairs, then for results that do not belong to one pair.

        The first wait ends when no result has arrived for the largest `quiet_s` of the nodes, so that a replay at a
        rate does not fail because of lost pairs.
        """
        quiet_s = max(node.quiet_s for node in self.nodes.values())
        self.collector.wait_while_results_arrive(self._has_all_results, quiet_s)
        for node in self.nodes.values():
            node.finish()
        self._check_nodes()

    def _check_nodes(self) -> None:
        for node in self.nodes.values():
            node.check()

    def _has_all_results(self) -> bool:
        """Return whether the results of all pairs are complete or no longer awaited."""
        received = self.collector.received
        return all(
            node.is_settled(stamp_ns) for task, node in self.nodes.items() for stamp_ns in received.of(task).sent_ns
        )
