"""An external node under test during a replay: waited for, its answers noted and kept, its end a finding."""

from __future__ import annotations

import os
from typing import Any

from rclpy.qos import QoSProfile, ReliabilityPolicy

from sfr_loc_map.errors import ConfigError, NodeError
from sfr_loc_map.inputs import Task
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.nodes.process.command_process import CommandProcess
from sfr_loc_map.nodes.replay.external_answers import CloudAnswers, OdometryAnswers
from sfr_loc_map.nodes.replay.external_options import ExternalOptions
from sfr_loc_map.nodes.replay.replay_node import ReplayNode
from sfr_loc_map.nodes.replay.results import ObservedNode, ReplayResults
from sfr_loc_map.pipeline.external_run import AnswerBook, ProcessWatch, processes_named

DEPTH = 1000
PUBLISHER_GRACE_S = 2.0
"""How long the publisher of a node that listens already is waited for; some make it with their first result."""
NOT_YET_NAMED = "_NODE_NAME_UNKNOWN_"
"""Name in ROS of a publisher whose node is not discovered yet."""
UNNAMED = "external"


class ExternalNode:
    """A node of anyone in place of one of ours.

    Attributes:
        options: What is known of it.
        name: Its name in the graph, once it is ready.
        version: As it tells on /diagnostics; None where it does not.
    """

    def __init__(
        self,
        node: ReplayNode,
        options: ExternalOptions,
        command: CommandProcess | None,
        answers: OdometryAnswers | CloudAnswers,
    ) -> None:
        """Subscribe to nothing yet.

        Args:
            node: Joins the graph.
            options: What is known of it.
            command: Its process, None where it was not started here.
            answers: Reads and keeps what it publishes.
        """
        self.options, self.name = options, UNNAMED
        self._node, self._command, self._answers = node, command, answers
        self.version: str | None = None
        self._results = ReplayResults()
        self._watch: ProcessWatch | None = None

    def begin_run(self, results: ReplayResults) -> None:
        """Put what is received from now on into the results of a run."""
        results.answers = AnswerBook(self.options.task.rig, self.options.timeout_s, self.options.frames)
        self._results = results
        self._answers.begin_run()

    def wait_until_ready(self, topics: list[str]) -> None:
        """Wait until it listens to images, and subscribe to its answers with the reliability that it offers.

        Args:
            topics: Images of its rig.

        Raises:
            NodeError: If it does not listen in time, or its process ends.
        """
        graph = self._node.node

        def listens() -> bool:
            if self._command is not None and self._command.ended:
                raise NodeError(f"the external node {self._command.ended}; correct that and start again")
            return any(graph.count_subscribers(topic) for topic in topics)

        def problem() -> str:
            domain = os.environ.get("ROS_DOMAIN_ID") or 0
            return (
                f"no external node in ROS domain {domain} listens to {' or '.join(topics)}: start it with --command, "
                "or set ROS_DOMAIN_ID for both, and remap its topics; nothing came"
            )

        self._node.wait_for(listens, self.options.start_timeout_s, problem)
        publishers = self._publishers()
        names = {item.node_name for item in publishers} - {NOT_YET_NAMED}
        self.name = ", ".join(sorted(names)) or self._name_of_command()
        offered = {item.qos_profile.reliability for item in publishers}
        policy = (
            ReliabilityPolicy.RELIABLE if offered == {ReliabilityPolicy.RELIABLE} else ReliabilityPolicy.BEST_EFFORT
        )
        quality = QoSProfile(depth=DEPTH, reliability=policy)
        graph.create_subscription(self._answers.kind, self.options.topic, self._on_answer, quality)
        self._watch = self._watched()
        if self._watch is not None:
            self._watch.start()

    def _watched(self) -> ProcessWatch | None:
        """Return the watch over its processes; None where they are not known."""
        if self.options.watch:
            return ProcessWatch(processes_named(self.options.watch))
        return None if self._command is None else ProcessWatch([self._command.pid])

    def observe(self, results: ReplayResults) -> None:
        """Put what is known of it into the results, while it still runs, and stop watching it."""
        self.look_after()
        if self._watch is not None:
            self._watch.stop()
        usage = None if self._watch is None else self._watch.usage
        log = "" if self._command is None else self._command.text
        results.observed = ObservedNode(self.name, self.version, self.options, usage, log)

    def published(self, stamp_ns: int, sent_s: float) -> None:
        """Note that a pair was published, its last image at a time of the monotonic clock."""
        self._book.published(stamp_ns, sent_s)

    def wait_for(self, stamp_ns: int) -> None:
        """Wait until a pair is answered, its time is over, or the process is gone.

        Raises:
            NodeError: If a node of the suite ends.
        """
        book = self._book

        def settled() -> bool:
            self.look_after()
            return book.is_settled(stamp_ns)

        self._node.wait_for(settled, self.options.timeout_s + 60.0, lambda: "nothing")  # a pair is settled before
        book.waited(stamp_ns)

    def look_after(self) -> None:
        """Note whether its process has ended."""
        if self._command is not None and (ended := self._command.ended):
            self._book.node_ended(ended)

    @property
    def _book(self) -> AnswerBook:
        assert self._results.answers is not None  # made by begin_run
        return self._results.answers

    def _on_answer(self, message: Any) -> None:  # noqa: ANN401 - rclpy has no types
        answer = self._answers.read(message)
        if self._book.received(answer):
            self._answers.keep(message, self._results)

    def _publishers(self) -> list[Any]:
        """Return who publishes the answers, as far as is known after a while."""
        found: list[Any] = []
        for _ in range(round(PUBLISHER_GRACE_S / 0.1)):
            found = list(self._node.node.get_publishers_info_by_topic(self.options.topic))
            if found and all(item.node_name != NOT_YET_NAMED for item in found):
                break
            self._node.spin_for(0.1)
        return found

    def _name_of_command(self) -> str:
        return UNNAMED if self._command is None else os.path.basename(self._command.words[0])


def external_node(
    node: ReplayNode, source: Source, options: ExternalOptions | None, command: CommandProcess | None
) -> ExternalNode | None:
    """Return the external node of a replay, None without one.

    Args:
        node: Joins the graph.
        source: What is replayed.
        options: What is known of it.
        command: Its process, None where it was not started here.

    Raises:
        ConfigError: If the source has no pairs for its task, or its convention is none of this source.
    """
    if options is None:
        return None
    answers: OdometryAnswers | CloudAnswers
    if options.task is Task.LOCALISATION and source.loc is not None:
        answers = OdometryAnswers(node.node, options, source.loc.rig, source.loc.ground_truth)
    elif options.task is Task.MAPPING and source.nav is not None:
        poses = {item.pair.stamp_ns: item.T_lm_navsb for item in source.nav.pairs()}
        answers = CloudAnswers(node.node, options, source.nav.rig, poses)
    else:
        raise ConfigError(f"'--external {options.task}': the source has no pairs for it; give one that has them")
    return ExternalNode(node, options, command, answers)
