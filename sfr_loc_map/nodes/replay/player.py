"""Plays a source over topics to the running nodes and records what they answer."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import rclpy
from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown
from std_srvs.srv import Trigger

from sfr_loc_map.errors import InputError, NodeError
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.nodes.messages.fields import header_msg
from sfr_loc_map.nodes.messages.message_types import message_type
from sfr_loc_map.nodes.messages.pose import pose_msg
from sfr_loc_map.nodes.process.supervisor import Supervisor
from sfr_loc_map.nodes.replay.control_services import offer_controls
from sfr_loc_map.nodes.replay.keyboard import Keyboard
from sfr_loc_map.nodes.replay.result_collector import Recording
from sfr_loc_map.pipeline.playback.controls import Controls, Pace, Pairs
from sfr_loc_map.pipeline.playback.messages import Message

NAME = "sfr_player"
START_TIMEOUT_S = 300.0
"""Starting compiles machine code where that was never done before."""
ANSWER_TIMEOUT_S = 120.0
QUIET_S = 5.0
"""At a rate, answers are awaited for so long after the last one."""
REPORT_TIMEOUT_S = 20.0
SETTLE_S = 0.3
SOURCE_DEPTH = 20
COLLECT_S = 0.05


class Player:
    """Publishes messages of a source and records the answers; a context manager."""

    def __init__(
        self, supervisor: Supervisor, topics: Mapping[str, str], controls: Controls, keyboard: Keyboard
    ) -> None:
        """Join the graph; signals stay with the program.

        Args:
            supervisor: The nodes.
            topics: Types of the topics to be published, by name.
            controls: What the operator wants.
            keyboard: Another way to say it.
        """
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self.recording = Recording()
        self.controls = controls
        self._supervisor, self._keyboard = supervisor, keyboard
        self._node: Node = rclpy.create_node(NAME)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        depth = QoSProfile(depth=SOURCE_DEPTH)
        self._publishers = {
            name: self._node.create_publisher(message_type(kind), name, depth) for name, kind in topics.items()
        }
        self._initial_pose = self._node.create_publisher(PoseWithCovarianceStamped, "initialpose", depth)
        self.recording.listen(self._node)
        self._resets = {name: self._node.create_client(Trigger, f"{name}/reset") for name in supervisor.pids}
        offer_controls(self._node, controls)

    def __enter__(self) -> Player:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Leave the graph."""
        self._node.destroy_node()
        try_shutdown()

    def wait_until_ready(self) -> None:
        """Wait until all nodes listen and are connected.

        Raises:
            NodeError: If a node ends, or it takes too long.
        """

        def ready() -> bool:
            if not all(client.service_is_ready() for client in self._resets.values()):
                return False
            publishers = self._publishers.values()
            return all(p.get_subscription_count() == self._node.count_subscribers(p.topic_name) for p in publishers)

        self._wait_for(ready, START_TIMEOUT_S, lambda: f"the nodes {', '.join(self._resets)} did not start")
        self._spin_for(SETTLE_S)

    def set_pose(self, pose: Transform) -> None:
        """Publish the pose at which localisation shall start, in its own world frame, and wait until it has arrived."""
        message = PoseWithCovarianceStamped(header=header_msg(0, ""))
        message.pose.pose = pose_msg(pose, pose.file_quat_xyzw)
        self._initial_pose.publish(message)
        self._wait_for(self._delivered, ANSWER_TIMEOUT_S, lambda: "initialpose was not taken by localisation_node")

    def begin_anew(self) -> None:
        """Let the nodes forget what came before.

        Raises:
            NodeError: If one does not answer.
        """
        for name, client in self._resets.items():
            self._call(client, f"{name} did not reset")
        self._spin_for(SETTLE_S)  # what was on its way
        self.recording.forget()

    def play(self, messages: Iterator[Message], progress: Callable[[str], None]) -> None:
        """Publish messages as the controls want, until they are at an end or the controls interrupt.

        Args:
            messages: In the order in which they are to be published.
            progress: Called with `loc` or `nav` for each stereo pair published.

        Raises:
            NodeError: If a node ends or does not answer.
            InputError: If a node refuses what it was given (rate 0).
        """
        pairs = Pairs()
        pace = Pace(self.controls)
        for message in messages:
            self._hold(pace, message)
            if self.controls.interrupted:
                return
            self._publishers[message.topic].publish(message.raw)
            pair = pairs.add(message)
            if pair is None:
                continue
            self.recording.published.add(pair)
            if self.controls.rate > 0:
                self._supervisor.check()
            else:
                self._await_result(*pair)
            self.controls.steps = max(self.controls.steps - 1, 0)
            progress(pair[0])

    def _hold(self, pace: Pace, message: Message) -> None:
        """Wait until a message is due, or until the controls interrupt."""
        while True:
            for key in self._keyboard.pressed():
                self.controls.key(key)
            wait_s = pace.wait_s(message)
            if self.controls.interrupted or not (wait_s or self.controls.held):
                break
            self._spin_until(time.monotonic() + min(wait_s or COLLECT_S, COLLECT_S))
            self._supervisor.check()
        self._executor.spin_once(timeout_sec=0.0)

    def finish(self, pairs_per_map: int) -> None:
        """Wait for what is still to come: results, cloud, the monitor's report.

        Args:
            pairs_per_map: Pairs after which the mapper makes a cloud by itself.
        """
        published = self.recording.published
        mapped = sum(bench == "nav" for bench, _ in published)
        clouds = mapped // pairs_per_map if pairs_per_map else 0
        if mapped and mapped % pairs_per_map:
            for bench, stamp_ns in sorted(published):
                if bench == "nav":
                    self._await_result(bench, stamp_ns)
            self._call(self._node.create_client(Trigger, "mapping_node/finish"), "mapping_node did not finish its map")
            clouds += 1

        self.settle(clouds)
        self._await_report(clouds > 0)

    def settle(self, clouds: int = 0) -> None:
        """Wait for the results of what was published, as long as some come.

        Args:
            clouds: How many clouds there will be.
        """
        published = self.recording.published

        def complete() -> bool:
            return all(self.recording.answered(*pair) for pair in published) and len(self.recording.clouds) >= clouds

        count, deadline = -1, 0.0
        while not complete() and (count != self.recording.answers or time.monotonic() < deadline):
            if count != self.recording.answers:
                count, deadline = self.recording.answers, time.monotonic() + QUIET_S
            self._spin_for(COLLECT_S)

    def _await_report(self, with_map: bool) -> None:
        """Wait for the report that has everything; without it the score is made of the recording all the same."""
        deadline = time.monotonic() + REPORT_TIMEOUT_S
        while time.monotonic() < deadline:
            report = json.loads(self.recording.report or "{}")
            poses = report.get("trajectory", {}).get("estimate_poses", len(self.recording.rows))
            calls = sum(report.get("timing", {}).get(f"{n}_s", {}).get("count", 0) for n in ("localisation", "mapping"))
            done = len(self.recording.localisation) + sum(kind == "mapped" for kind, _ in self.recording.mapping)
            has_truth = "ground_truth/points" in self._publishers
            if (
                poses >= len(self.recording.rows)
                and calls >= done
                and ("map" in report or not (with_map and has_truth))
            ):
                return
            self._spin_for(COLLECT_S)

    def _await_result(self, bench: str, stamp_ns: int) -> None:
        name = {"loc": "localisation_node", "nav": "mapping_node"}[bench]

        def answered() -> bool:
            if self.recording.problem:
                raise InputError(self.recording.problem)
            return self.recording.answered(bench, stamp_ns)

        def problem() -> str:
            words = self._supervisor.last_log_line(name)
            return f"{name} gave no result for the pair of stamp {stamp_ns} (its last words: {words})"

        self._wait_for(answered, ANSWER_TIMEOUT_S, problem)

    def _delivered(self) -> bool:
        publisher = self._initial_pose
        return bool(publisher.get_subscription_count()) and bool(publisher.wait_for_all_acked(Duration(seconds=0.05)))

    def _call(self, client: Any, problem: str) -> None:  # noqa: ANN401 - rclpy has no types for it
        """Call a Trigger service and wait for its answer."""
        self._wait_for(client.service_is_ready, ANSWER_TIMEOUT_S, lambda: problem)
        future = client.call_async(Trigger.Request())
        self._wait_for(future.done, ANSWER_TIMEOUT_S, lambda: problem)

    def _wait_for(self, condition: Callable[[], bool], timeout_s: float, problem: Callable[[], str]) -> None:
        deadline = time.monotonic() + timeout_s
        while not condition():
            self._supervisor.check()
            if time.monotonic() > deadline:
                raise NodeError(f"{problem()} within {timeout_s:g} s: look at the load of this host and start again")
            self._executor.spin_once(timeout_sec=COLLECT_S)

    def _spin_for(self, seconds: float) -> None:
        self._spin_until(time.monotonic() + seconds)
        self._supervisor.check()

    def _spin_until(self, moment: float) -> None:
        while (left := moment - time.monotonic()) > 0:
            self._executor.spin_once(timeout_sec=min(left, COLLECT_S))
