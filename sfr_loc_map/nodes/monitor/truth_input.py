"""Receive the true poses of a running graph from a topic of any supported type, or from frames on /tf."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable
from functools import partial
from typing import Any, Protocol

from rclpy.node import Node
from rclpy.qos import QoSProfile

from sfr_loc_map.errors import ConfigError, SfrError
from sfr_loc_map.inputs import refusing
from sfr_loc_map.io.bag.frames import FrameSeries, PoseRow, chain_above, chain_poses, pose_row
from sfr_loc_map.io.truth.messages import TRUTH_TYPES, UNKNOWN, TrueRow, TruthReader
from sfr_loc_map.message_types import ODOMETRY
from sfr_loc_map.ros.messages import message_type, tf_message_type
from sfr_loc_map.ros.publishers import participants_of, publishers_of
from sfr_loc_map.ros.qos import TF_STATIC_QOS
from sfr_loc_map.ros.truth_subscription import TruthSubscription
from sfr_loc_map.run_order import RunOrder
from sfr_loc_map.topics import TF, TF_STATIC, TRUE_POSES
from sfr_loc_map.transport_issues import Reliability, silence_of

MAX_WAITING = 1000  #: Maximum number of transforms per frame that wait for other frames; the oldest are dropped.


class FramePoses:
    """Makes true poses from the messages of /tf and /tf_static: the poses of a frame in one of its ancestors.

    As with a bag, the poses have the stamps of the most frequent transform of the chain. A pose is computed once the
    other transforms of the chain are available at its stamp.
    """

    def __init__(self, frame: str) -> None:
        """Accept a frame and one of its ancestors as `PARENT:CHILD`; raise a ConfigError for any other text."""
        self._parent, _, self._child = (name.strip("/") for name in frame.rpartition(":"))
        if not self._parent or not self._child:
            raise ConfigError(f"truth.frame is '{frame}': a node requires both frames, as PARENT:CHILD")
        self._series = FrameSeries()
        self._orders: dict[tuple[str, str], RunOrder[PoseRow]] = {}
        self._received = Counter[str]()  # number of transforms of each frame
        self._last_ns = 0  # stamp of the last pose of the run
        self._restarted = set[str]()  # transforms that have started a new run since the last pose

    @property
    def strays(self) -> int:
        """Number of transforms that were dropped because of their stamps."""
        return sum(order.strays for order in list(self._orders.values()))  # another thread may add orders

    def rows(self, message: Any, *, is_static: bool) -> list[TrueRow]:  # noqa: ANN401 - tf2_msgs need not be there
        """Return the true poses that a message completes, ordered by stamp."""
        for item in message.transforms:
            self._add(item, is_static=is_static)
        frames = self._series.chosen(self._child, self._parent)
        with refusing("/tf", "give truth.frame=PARENT:CHILD so that each frame between them has one parent"):
            chain = chain_above(frames, self._child, self._parent)
        moving = [name for name in chain if not frames[name].is_static]
        if not moving or frames[chain[-1]].parent != self._parent or not all(frames[name].rows for name in chain):
            return []
        if self._restarted.intersection(moving):
            self._last_ns = 0
        self._restarted.clear()
        stamps_of = max(moving, key=lambda name: self._received[name])
        with refusing("/tf", "correct the publisher"):
            poses = chain_poses(frames, chain, stamps_of)
        found: list[TrueRow] = []
        for stamp_ns, position, quat in zip(
            poses.stamps_ns.tolist(), poses.positions.tolist(), poses.quats_xyzw.tolist(), strict=True
        ):
            if stamp_ns > self._last_ns:
                found.append((stamp_ns, (*position, *quat), UNKNOWN))
        if found:
            self._last_ns = found[-1][0]
            for name in moving:
                _forget_before(frames[name].rows, self._last_ns)
        return found

    def _add(self, item: Any, *, is_static: bool) -> None:  # noqa: ANN401 - a geometry_msgs/TransformStamped
        frame = self._series.frame_of(item, is_static=is_static)
        row = pose_row(item, item.transform)
        if frame.is_static:
            frame.rows[:] = [row]
            return
        name = item.child_frame_id.strip("/")
        accepted, begins_run = self._orders.setdefault((name, frame.parent), RunOrder()).add(row[0], row)
        if begins_run:
            frame.rows.clear()
            self._received[name] = 0
            self._restarted.add(name)
        frame.rows += accepted
        self._received[name] += len(accepted)
        del frame.rows[:-MAX_WAITING]


class Subscribe(Protocol):
    """Subscribes with a callback; returns the function that unsubscribes."""

    def __call__(  # noqa: D102
        self,
        kind: type[Any],
        topic: str,
        callback: Callable[[Any], None],
        qos: QoSProfile,
        *,
        of_one_publisher: bool = True,
    ) -> Callable[[], object]: ...


class TruthInput(ABC):
    """Receives the true poses that a node uses for scoring."""

    @abstractmethod
    def subscribe(self, add_subscription: Subscribe, qos: QoSProfile, add: Callable[[list[TrueRow]], None]) -> None:
        """Receive true poses; `add` is called with the poses of each message."""

    @property
    def strays(self) -> int:
        """Number of messages that were dropped because of their stamps."""
        return 0

    def follow_type(self) -> bool:
        """Subscribe with the published type of true poses if it has changed; return whether it has changed."""
        return False

    def types_beside(self) -> list[type[Any]]:
        """Return the published types of true poses that are not received, because only one type can be received."""
        return []

    def participants(self) -> set[tuple[int, ...]]:
        """Return the participants that publish true poses; empty if the topic also carries other data."""
        return set()

    @abstractmethod
    def reason_for_silence(self) -> str:
        """Return why no true pose was received."""


class TopicTruthInput(TruthInput):
    """Receives true poses on their topic, with any type of `TRUTH_TYPES`."""

    def __init__(self, node: Node, reliability: Reliability) -> None:
        """Start without a subscription."""
        self._node, self._reliability = node, reliability
        self._msgtype = ODOMETRY
        self._reader = TruthReader(ODOMETRY)
        self._unusable = ""  # why the last message was not used; empty if it was used or none was received

    def subscribe(self, add_subscription: Subscribe, qos: QoSProfile, add: Callable[[list[TrueRow]], None]) -> None:
        """Subscribe with the type of the previous activation, or nav_msgs/Odometry in the first activation.

        `follow_type` changes to the published type.
        """

        def subscribe_to(msgtype: str) -> Callable[[], object]:
            if msgtype != self._msgtype:
                self._msgtype, self._reader = msgtype, TruthReader(msgtype)
            reader = self._reader
            self._unusable = ""

            def received(message: Any) -> None:  # noqa: ANN401 - of any type in TRUTH_TYPES
                try:
                    rows = reader.rows(message)
                    self._unusable = _unusable(rows)
                    add(rows)
                except SfrError as error:
                    self._unusable = str(error)
                    raise

            return add_subscription(message_type(msgtype), TRUE_POSES, received, qos)

        self._subscription = TruthSubscription(subscribe_to, self._msgtype)

    def follow_type(self) -> bool:
        """Subscribe with the published type of true poses if it has changed; return whether it has changed."""
        publishers = publishers_of(self._node, self._node.resolve_topic_name(TRUE_POSES))
        has_changed = self._subscription.follow([publisher.msgtype for publisher in publishers])
        if has_changed:
            self._node.get_logger().info(
                f"{TRUE_POSES} has the type {self._subscription.msgtype}: true poses are read with it"
            )
        return has_changed

    def types_beside(self) -> list[type[Any]]:
        """Return the published types of true poses that are not received, because only one type can be received."""
        published = publishers_of(self._node, self._node.resolve_topic_name(TRUE_POSES))
        types = {publisher.msgtype for publisher in published}.intersection(TRUTH_TYPES)
        return [message_type(name) for name in types - {self._subscription.msgtype}]

    def participants(self) -> set[tuple[int, ...]]:
        """Return the participants that publish true poses."""
        return participants_of(self._node, self._node.resolve_topic_name(TRUE_POSES))

    def reason_for_silence(self) -> str:
        """Return why no true pose was received."""
        topic = self._node.resolve_topic_name(TRUE_POSES)
        if self._unusable:
            return f"nothing is scored without true poses on {topic}: {self._unusable}"
        found = silence_of(topic, tuple(TRUTH_TYPES), publishers_of(self._node, topic), self._reliability)
        return f"nothing is scored without true poses on {topic}: {found.text}; {found.fix}"


class FrameTruthInput(TruthInput):
    """Receives true poses from /tf and /tf_static, which may each have several publishers."""

    def __init__(self, frame: str) -> None:
        """Accept a frame and one of its ancestors as `PARENT:CHILD`; raise a ConfigError for any other text."""
        self._frame = frame
        self._reader = FramePoses(frame)

    def subscribe(self, add_subscription: Subscribe, qos: QoSProfile, add: Callable[[list[TrueRow]], None]) -> None:
        """Receive the transforms."""
        kind = tf_message_type()
        if kind is None:
            raise ConfigError("truth.frame: tf2_msgs for /tf is not installed: install ros-jazzy-tf2-msgs")

        def on_transforms(message: Any, *, is_static: bool) -> None:  # noqa: ANN401 - of tf2_msgs
            add(self._reader.rows(message, is_static=is_static))

        on_static = partial(on_transforms, is_static=True)
        on_moving = partial(on_transforms, is_static=False)
        add_subscription(kind, TF_STATIC, on_static, TF_STATIC_QOS, of_one_publisher=False)
        add_subscription(kind, TF, on_moving, qos, of_one_publisher=False)

    @property
    def strays(self) -> int:
        """Number of transforms that were dropped because of their stamps."""
        return self._reader.strays

    def reason_for_silence(self) -> str:
        """Return which transforms are required."""
        return f"nothing is scored without the transforms {self._frame} on /tf: publish them"


def _unusable(rows: list[TrueRow]) -> str:
    """Return why the poses of a message are not used, and the fix; empty if they are used."""
    if not rows:
        return "its messages contain no pose, such as a NavSatFix without a fix; check the sensor"
    if all(stamp_ns <= 0 for stamp_ns, *_ in rows):
        return "its poses have the stamp 0; publish them with the time of the measurement"
    return ""


def _forget_before(rows: list[PoseRow], stamp_ns: int) -> None:
    """Drop the rows that are not required to interpolate at this stamp or later."""
    while len(rows) > 1 and rows[1][0] <= stamp_ns:
        rows.pop(0)
