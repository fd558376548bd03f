"""Publishes the messages of a source to the running nodes."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping

from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.duration import Duration
from rclpy.qos import QoSProfile

from sfr_loc_map.localisation.start_pose import StartPose
from sfr_loc_map.nodes.messages.fields import header_msg
from sfr_loc_map.nodes.messages.message_types import message_type
from sfr_loc_map.nodes.messages.pose import pose_msg
from sfr_loc_map.nodes.replay.control_services import offer_controls
from sfr_loc_map.nodes.replay.replay_node import ANSWER_TIMEOUT_S, SPIN_S, ReplayNode
from sfr_loc_map.nodes.replay.result_collector import ResultCollector
from sfr_loc_map.pipeline.controls import Controls, Keyboard
from sfr_loc_map.pipeline.message_stream import Message, Pacer, PairTracker

START_TIMEOUT_S = 300.0
"""The first start after an installation compiles the kernels."""
SETTLE_S = 0.3
SOURCE_DEPTH = 20


class Player:
    """Publishes messages as the operator's controls want."""

    def __init__(
        self,
        node: ReplayNode,
        collector: ResultCollector,
        topics: Mapping[str, str],
        controls: Controls,
        keyboard: Keyboard,
    ) -> None:
        """Advertise the topics and the services of the controls.

        Args:
            node: Joins the graph.
            collector: Collects the results; in lock step they are awaited.
            topics: Types of the topics to be published, by name.
            controls: State that the operator controls.
            keyboard: Keys of the operator.
        """
        self.collector, self.controls = collector, controls
        self._node, self._keyboard = node, keyboard
        depth = QoSProfile(depth=SOURCE_DEPTH)
        self._publishers = {
            name: node.node.create_publisher(message_type(kind), name, depth) for name, kind in topics.items()
        }
        self._initial_pose = node.node.create_publisher(PoseWithCovarianceStamped, "initialpose", depth)
        self._resets = {name: node.client(f"{name}/reset") for name in node.supervisor.processes}
        offer_controls(node.node, controls)

    def wait_until_ready(self) -> None:
        """Wait until all nodes listen and are connected.

        Raises:
            NodeError: If a node ends, or it takes too long.
        """

        def ready() -> bool:
            if not all(client.service_is_ready() for client in self._resets.values()):
                return False
            publishers = self._publishers.values()
            return all(
                p.get_subscription_count() == self._node.node.count_subscribers(p.topic_name) for p in publishers
            )

        self._node.wait_for(ready, START_TIMEOUT_S, lambda: f"the nodes {', '.join(self._resets)} did not start")
        external = self.collector.external
        if external is not None:
            rig = f"{external.options.task.rig}/"
            images = [name for name in self._publishers if name.startswith(rig) and "image_rect" in name]
            external.wait_until_ready(images)
        self._node.spin_for(SETTLE_S)

    def set_pose(self, start: StartPose) -> None:
        """Publish the pose at which localisation starts, in its own world frame, and wait until it is received."""
        message = PoseWithCovarianceStamped(header=header_msg(start.stamp_ns or 0, ""))
        message.pose.pose = pose_msg(start.T_ds_rb, start.T_ds_rb.file_quat_xyzw)
        self._initial_pose.publish(message)
        if "localisation_node" not in self._resets:
            return  # an external node may listen to it or not
        self._node.wait_for(
            self._pose_delivered, ANSWER_TIMEOUT_S, lambda: "localisation_node did not receive initialpose"
        )

    def reset_nodes(self) -> None:
        """Reset the nodes and the results for another run.

        Raises:
            NodeError: If one does not answer.
        """
        for name in self._resets:
            self._node.call(f"{name}/reset", f"{name} did not reset")
        self._node.spin_for(SETTLE_S)  # results on their way
        self.collector.begin_run()

    def play(self, messages: Iterator[Message], progress: Callable[[str], None]) -> None:
        """Publish messages until their end or until the controls interrupt.

        Args:
            messages: In the order in which they are to be published.
            progress: Called with `loc` or `nav` for each stereo pair published.

        Raises:
            NodeError: If a node ends or does not answer.
            InputError: If a node refuses its input (rate 0).
        """
        pairs, pacer = PairTracker(), Pacer(self.controls)
        for message in messages:
            self._hold(pacer, message)
            if self.controls.interrupted:
                return
            sent_s = time.monotonic()
            self._publishers[message.topic].publish(message.raw)
            pair = pairs.add(message)
            if pair is None:
                continue
            self.collector.published(*pair, sent_s)
            if self.controls.rate > 0:
                self._node.supervisor.check()
                if self.collector.external is not None:
                    self.collector.external.look_after()
            else:
                self.collector.wait_for_pair(*pair)
            self.controls.step_done()
            progress(pair[0])

    def _hold(self, pacer: Pacer, message: Message) -> None:
        """Wait until a message is due, or until the controls interrupt."""
        while True:
            for key in self._keyboard.pressed():
                self.controls.key(key)
            wait_s = pacer.wait_s(message)
            if self.controls.interrupted or not (wait_s or self.controls.held):
                break
            self._node.spin_for(min(wait_s or SPIN_S, SPIN_S))
        self._node.spin_once()

    def _pose_delivered(self) -> bool:
        publisher = self._initial_pose
        return bool(publisher.get_subscription_count()) and bool(publisher.wait_for_all_acked(Duration(seconds=0.05)))
