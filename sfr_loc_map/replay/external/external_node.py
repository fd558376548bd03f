"""The external node of a replay: found by its subscription, awaited like our nodes, and judged by its answers."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from contextlib import suppress
from typing import Any

from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo

from sfr_loc_map.errors import ConfigError, NodeError
from sfr_loc_map.message_stamps import stamp_of
from sfr_loc_map.message_text import alternatives
from sfr_loc_map.methods.method_call import MethodFailureError
from sfr_loc_map.metrics.figures.records import CallFinding, ConventionRecord, ExternalScore, MethodKind, MethodRecord
from sfr_loc_map.replay.external.answer_book import AnswerBook
from sfr_loc_map.replay.external.answer_converters import DEPTH, AnswerConverter
from sfr_loc_map.replay.external.process_watch import ProcessWatch, processes_watched
from sfr_loc_map.replay.external.publisher_check import PublisherCheck
from sfr_loc_map.replay.options import ExternalOptions
from sfr_loc_map.replay.replay_peer import ReplayPeer
from sfr_loc_map.replay.result import ExternalResult
from sfr_loc_map.replay.waiting import QUIET_S, AwaitedNode
from sfr_loc_map.ros.processes import ChildProcess
from sfr_loc_map.ros.publishers import UNKNOWN_NODE
from sfr_loc_map.suite_names import Task
from sfr_loc_map.topics import RECTIFIED

PUBLISHER_GRACE_S = 2.0
"""Maximum wait for the publisher of a subscribed node. Some nodes create their publisher with the first result."""


class ExternalNode(AwaitedNode):
    """A connected external node: counts its answers, accepts those that are used, and measures its process.

    Missing answers and the end of the process are findings.
    """

    def __init__(
        self,
        peer: ReplayPeer,
        options: ExternalOptions,
        command: ChildProcess | None,
        converter: AnswerConverter,
        *,
        name: str,
        watch: ProcessWatch | None,
    ) -> None:
        """Set the process and the name of a node that `connected_node` has found.

        `command` is None if the node was not started by the replay, and `watch` if no process is measured.
        """
        self._peer = peer
        self._options = options
        self._command = command
        self._converter = converter
        self._name = name
        self._watch = watch
        self._answers = AnswerBook[tuple[Any, Any]](options.timeout_s, options.frames)
        self._publishers = PublisherCheck(peer, options.topic, watch)

    @property
    def quiet_s(self) -> float:
        """Time without any result, s, after which missing answers are no longer awaited: at least their timeout."""
        return max(QUIET_S, self._options.timeout_s)

    def receive(self, message: Any) -> None:  # noqa: ANN401 - of the converter's `kind`
        """Count an answer, and accept it if it is used. An answer before its pair is accepted once the pair is sent."""
        self._publishers.note_answer()
        content, problem = None, None
        try:
            content = self._converter.read(message)
        except MethodFailureError as error:
            problem = CallFinding(error.kind, str(error))
        frames = self._converter.frames_of(message)
        used = self._answers.note_answer(stamp_of(message), frames, problem, (message, content))
        if used is not None:
            self._converter.accept(*used)

    def note_sent(self, stamp_ns: int, sent_s: float) -> None:
        """Record a pair and the time of the monotonic clock when its last image was published, s."""
        if (early := self._answers.note_sent(stamp_ns, sent_s)) is not None:
            self._converter.accept(*early)

    def wait_for(self, stamp_ns: int) -> None:
        """Wait until a pair is answered, its timeout has passed, or the process has ended."""

        def settled() -> bool:
            self.check()
            self._peer.supervisor.check()
            return self.is_settled(stamp_ns)

        self._peer.spin(math.inf, settled)
        self._answers.note_waited(stamp_ns)

    def is_settled(self, stamp_ns: int) -> bool:
        """Return whether a pair is answered, or its answer is no longer awaited."""
        return self._answers.is_settled(stamp_ns)

    def check(self) -> None:
        """Note whether the process of the node has ended, even if a script has restarted it.

        ConfigError if the process to watch is not that of the answers' publisher.
        """
        if self._command is not None and self._command.ending:
            self._answers.note_end(_ended(self._command))
            return
        self._publishers.update()
        if self._options.watch and not self._publishers.is_measured:
            raise ConfigError(
                f"'--watch {self._options.watch}': the publisher of {self._options.topic} belongs to another process; "
                "give the process of the node under test"
            )
        if self._publishers.have_restarted:
            topic = self._options.topic
            self._answers.note_restart(
                f"the publisher of its first answer on {topic} has disappeared, or another has appeared"
            )

    def result(self, version: str | None) -> ExternalResult:
        """Return answers and process of the node, and stop measuring the process; called while the process runs.

        `version` is the version that the calls of the node state.
        """
        with suppress(ConfigError):  # a wrong process to watch has ended the replay
            self.check()
        if self._watch is not None:
            self._watch.stop()
        answers = self._answers
        options = self._options
        score = ExternalScore(
            task=options.task.value,
            topic=options.topic,
            frames=answers.frames or "",
            answers=answers.counts,
            latency_s=answers.latency_s,
            process=self._watch.usage if self._watch is not None and self._publishers.is_measured else None,
            ended=answers.ended,
        )
        convention = None  # poses are converted later
        if options.task is Task.MAPPING and options.convention.settings:
            convention = ConventionRecord(declared=options.convention.settings)
        return ExternalResult(
            MethodRecord(name=self._name, version=version, kind=MethodKind.EXTERNAL),
            score,
            answers.findings,
            log="" if self._command is None else self._command.text,
            convention=convention,
        )


def connected_node(
    peer: ReplayPeer,
    options: ExternalOptions,
    command: ChildProcess | None,
    converter: AnswerConverter,
    topics: Iterable[str],
) -> ExternalNode:
    """Wait until an external node subscribes to images, subscribe to its answers, and start measuring its process.

    `command` is its process, None if the user has started it. `topics` are the topics of the replay.
    """
    rig = f"{options.task.rig}/"
    images = [name for name in topics if name.startswith(rig) and RECTIFIED in name]
    _wait_for_subscription(peer, options, command, images)
    publishers = _found_publishers(peer, options.topic)
    names = {item.node_name for item in publishers} - {UNKNOWN_NODE}
    started = "external" if command is None else command.name
    pids = [] if command is None else [command.popen.pid]
    if options.watch:
        pids = processes_watched(options.watch, pids)
    node = ExternalNode(
        peer,
        options,
        command,
        converter,
        name=", ".join(sorted(names)) or started,
        watch=ProcessWatch(pids) if pids else None,
    )
    # with the reliability that the publishers offer
    is_reliable = {item.qos_profile.reliability for item in publishers} == {ReliabilityPolicy.RELIABLE}
    policy = ReliabilityPolicy.RELIABLE if is_reliable else ReliabilityPolicy.BEST_EFFORT
    quality = QoSProfile(depth=DEPTH, reliability=policy)
    peer.ros_node.create_subscription(converter.kind, options.topic, node.receive, quality)
    return node


def _wait_for_subscription(
    peer: ReplayPeer, options: ExternalOptions, command: ChildProcess | None, topics: Sequence[str]
) -> None:
    """Wait until the node subscribes to one of the topics; raise a NodeError if it does not, or if its process ends."""

    def listens() -> bool:
        if command is not None and command.ending:
            raise NodeError(f"the external node {_ended(command)}; correct the cause and start again")
        return any(peer.ros_node.count_subscribers(topic) for topic in topics)

    def problem() -> str:
        return f"no external node subscribed to {alternatives(topics)}"

    advice = "start the node with --command, or with the same ROS_DOMAIN_ID, and remap its topics"
    peer.wait_for(listens, options.start_timeout_s, problem, advice)


def _found_publishers(peer: ReplayPeer, topic: str) -> list[TopicEndpointInfo]:
    """Return the publishers of a topic once their nodes are known, or after `PUBLISHER_GRACE_S`."""

    def are_named() -> bool:
        names = [item.node_name for item in peer.ros_node.get_publishers_info_by_topic(topic)]
        return bool(names) and UNKNOWN_NODE not in names

    peer.spin(PUBLISHER_GRACE_S, are_named)
    return list(peer.ros_node.get_publishers_info_by_topic(topic))


def _ended(command: ChildProcess) -> str:
    return f"{command.ending}: {command.last_log_line[:200]}"
