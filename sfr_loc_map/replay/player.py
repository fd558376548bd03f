"""Publish the messages of a source, in lock step or at a rate; an operator may pause the replay.

The services have the names of the rosbag2 player: `~/pause` and `~/resume` (std_srvs/Trigger).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping

from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from std_srvs.srv import Trigger

from sfr_loc_map.io.message_stream import Message
from sfr_loc_map.localisation.estimate import StartPose
from sfr_loc_map.replay.replay_peer import ANSWER_TIMEOUT_S, START_TIMEOUT_S, ReplayPeer
from sfr_loc_map.ros.messages import header_msg, message_type
from sfr_loc_map.ros.peer import POLL_S
from sfr_loc_map.ros.pose_messages import pose_msg
from sfr_loc_map.suite_names import Task
from sfr_loc_map.topics import INITIAL_POSE, INITIAL_POSE_SET

SOURCE_DEPTH = 20  #: Queue depth of the published topics: 5 pairs of the four topics of a rig.


class Pacer:
    """Computes when a message is due, from its stamp and the rate; each rig has its own clock."""

    def __init__(self, rate: float | None) -> None:
        """Set the rate, a multiple of the recorded speed; in lock step (None), each message is due immediately."""
        self._rate = rate
        self._origins: dict[str, tuple[float, int]] = {}  # by rig: time and stamp of the first message

    def restart(self) -> None:
        """Restart the clocks at the next message, as after a pause."""
        self._origins.clear()

    def wait_s(self, message: Message) -> float:
        """Return the time until a message is due, s; 0 if it is due."""
        if self._rate is None:
            return 0.0
        begin_s, first_ns = self._origins.setdefault(message.rig, (time.monotonic(), message.stamp_ns))
        return max(begin_s + (message.stamp_ns - first_ns) * 1e-9 / self._rate - time.monotonic(), 0.0)


class Player:
    """Publishes messages until their end or until `stop`; `connected_player` creates a player."""

    def __init__(self, peer: ReplayPeer, topics: Mapping[str, str], rate: float | None, *, paused: bool) -> None:
        """Advertise topics, given as name and type, and the services."""
        self.stopped = False
        self._paused = paused
        self._peer = peer
        self._has_localiser = Task.LOCALISATION.node in peer.supervisor.processes
        self._pacer = Pacer(rate)
        depth = QoSProfile(depth=SOURCE_DEPTH)
        self._publishers = {
            name: peer.ros_node.create_publisher(message_type(kind), name, depth) for name, kind in topics.items()
        }
        self._initial_pose = peer.ros_node.create_publisher(PoseWithCovarianceStamped, INITIAL_POSE, depth)
        self._poses_set: list[PoseWithCovarianceStamped] = []  # acknowledgements; those of Fast DDS take up to 3 s
        peer.ros_node.create_subscription(PoseWithCovarianceStamped, INITIAL_POSE_SET, self._poses_set.append, depth)
        for name, is_pause in (("pause", True), ("resume", False)):
            peer.ros_node.create_service(Trigger, f"~/{name}", self._server(is_pause))

    def stop(self) -> None:
        """Stop publishing."""
        self.stopped = True

    @property
    def publishers(self) -> list[Publisher]:
        """The publishers of the topics that nodes of the replay must receive.

        The start pose is among them if our localiser runs, because an external node need not subscribe to it.
        """
        of_start = [self._initial_pose] if self._has_localiser else []
        return [*self._publishers.values(), *of_start]

    def set_pose(self, start: StartPose) -> None:
        """Publish the start pose of the localisation, in its world frame, and wait until the node acknowledges it."""
        message = PoseWithCovarianceStamped(header=header_msg(start.stamp_ns or 0, ""))
        message.pose.pose = pose_msg(start.T_ds_rb, start.T_ds_rb.file_quat_xyzw)
        self._initial_pose.publish(message)
        if not self._has_localiser:
            return  # an external node need not acknowledge initialpose
        problem = "localisation_node did not receive initialpose"
        self._peer.wait_for(lambda: bool(self._poses_set), ANSWER_TIMEOUT_S, lambda: problem)

    def play(self, messages: Iterator[Message], on_sent: Callable[[Message], None]) -> None:
        """Publish messages of the advertised topics when they are due.

        `on_sent` is called after each message and may wait for results.
        """
        for message in messages:
            if message.topic not in self._publishers:
                continue
            while not self.stopped and (wait_s := self._wait_s(message)):
                self._peer.spin_for(min(wait_s, POLL_S))
            if self.stopped:
                return
            self._peer.executor.spin_once(timeout_sec=0.0)
            self._publishers[message.topic].publish(message.raw)
            on_sent(message)

    def _wait_s(self, message: Message) -> float:
        if self._paused:
            self._pacer.restart()
            return POLL_S
        return self._pacer.wait_s(message)

    def _server(self, is_pause: bool) -> Callable[..., Trigger.Response]:
        def serve(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            self._paused = is_pause
            response.success, response.message = True, "paused" if is_pause else "playing"
            return response

        return serve


def connected_player(peer: ReplayPeer, topics: Mapping[str, str], rate: float | None, *, paused: bool) -> Player:
    """Return a player once the started nodes are active and receive its topics, given as name and type.

    The nodes have then also discovered all subscriptions that this process created before the call.
    """
    player = Player(peer, topics, rate, paused=paused)
    node = peer.ros_node
    names = list(peer.supervisor.processes)
    # The service is offered once a node is active.
    resets = [node.create_client(Trigger, f"{name}/reset") for name in names]

    def is_connected() -> bool:
        if not all(client.service_is_ready() for client in resets):
            return False
        return all(p.get_subscription_count() == node.count_subscribers(p.topic_name) for p in player.publishers)

    peer.wait_for(is_connected, START_TIMEOUT_S, lambda: f"the nodes {', '.join(names)} did not start")
    peer.wait_for_discovery()
    return player
