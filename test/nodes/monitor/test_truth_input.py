"""True poses of /tf as a monitor makes them: those that a bag of the same messages gives."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
import rclpy
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile
from sensor_msgs.msg import NavSatFix, NavSatStatus

from helpers.message_bags import write_messages
from sfr_loc_map.errors import ConfigError
from sfr_loc_map.io.bag import messages as bag_messages
from sfr_loc_map.io.bag.encoding import TYPESTORE
from sfr_loc_map.io.registry import read_truth
from sfr_loc_map.io.source_config import SourceConfig
from sfr_loc_map.io.truth.config import TruthConfig
from sfr_loc_map.io.truth.messages import TruthReader
from sfr_loc_map.message_types import FIX, ODOMETRY
from sfr_loc_map.nodes.monitor.truth_input import FramePoses, TopicTruthInput
from sfr_loc_map.run_order import RunOrder
from sfr_loc_map.transport_issues import Reliability

T = TYPESTORE.types
BEGIN_NS, MS = 1_700_000_000_000_000_000, 1_000_000
Entry = tuple[str, int, Any]


def test_dropped_transforms_are_counted_while_another_thread_adds_a_transform() -> None:
    frame = FramePoses("map:base_link")

    class Growing:
        @property
        def strays(self) -> int:
            frame._orders["added meanwhile", "map"] = RunOrder()
            return 2

    frame._orders["base_link", "map"] = cast("Any", Growing())
    assert frame.strays == 2


@pytest.mark.parametrize(
    ("msgtype", "message", "words"),
    [
        (ODOMETRY, Odometry(), "stamp 0"),
        (FIX, NavSatFix(status=NavSatStatus(status=NavSatStatus.STATUS_NO_FIX)), "without a fix"),
    ],
)
def test_true_poses_that_are_received_but_unusable_have_their_own_reason(
    ros: None, msgtype: str, message: Any, words: str
) -> None:
    node = rclpy.create_node("judge")
    truth, callbacks = TopicTruthInput(node, Reliability.BEST_EFFORT), list[Any]()

    def subscribe(kind: type[Any], topic: str, callback: Any, qos: QoSProfile, **_: bool) -> Any:
        callbacks.append(callback)
        return callbacks.clear

    truth._msgtype = msgtype
    truth._reader = TruthReader(msgtype)
    truth.subscribe(subscribe, QoSProfile(depth=1), lambda rows: None)
    if isinstance(message, Odometry):
        message.pose.pose.orientation.w = 1.0
    assert "no publisher" in truth.reason_for_silence()
    callbacks[-1](message)
    assert words in truth.reason_for_silence()
    node.destroy_node()


def transform(stamp_ns: int, parent: str, child: str, xyz: Any, yaw: float) -> Any:
    quat = T["geometry_msgs/msg/Quaternion"](
        0.1, 0.0, float(np.sin(yaw / 2)), float(np.sqrt(0.99 - np.sin(yaw / 2) ** 2))
    )
    inner = T["geometry_msgs/msg/Transform"](T["geometry_msgs/msg/Vector3"](*map(float, xyz)), quat)
    return T["geometry_msgs/msg/TransformStamped"](bag_messages.header(stamp_ns, parent), child, inner)


def entries(slow_ms: int) -> list[Entry]:
    """Return /tf of a rover: odom to base_link at 20 Hz, map to odom slower (0: with each), another rover beside."""
    kind = T["tf2_msgs/msg/TFMessage"]
    found: list[Entry] = [
        ("/tf_static", BEGIN_NS - 1, kind([transform(BEGIN_NS - 1, "base_link", "marker", (0.2, 0.0, 1.0), 0.3)]))
    ]
    for k in range(100):
        stamp_ns = BEGIN_NS + k * 50 * MS
        moving = [transform(stamp_ns, "odom", "base_link", (0.1 * k, np.sin(0.1 * k), 0.01 * k), 0.02 * k)]
        moving.append(transform(stamp_ns + 7 * MS, "map", "other_rover", (-k, 0.0, 0.0), 0.0))
        found.append(("/tf", stamp_ns, kind(moving)))
        if (k * 50) % max(slow_ms, 50) == 0:
            late = stamp_ns + (3 * MS if slow_ms else 0)
            found.append(("/tf", late, kind([transform(late, "map", "odom", (5.0, 0.001 * k, 0.0), 0.001 * k)])))
    return found


@pytest.mark.parametrize("slow_ms", [0, 50, 200, 500])
def test_poses_are_those_of_a_bag(tmp_path: Path, slow_ms: int) -> None:
    reader, rows = FramePoses("map:marker"), []
    for topic, _, message in entries(slow_ms):
        rows += reader.rows(message, is_static=topic == "/tf_static")
    bag = read_truth(
        write_messages(tmp_path / "x", entries(slow_ms)), SourceConfig(truth=TruthConfig(frame="map:marker"))
    )
    assert len(rows) > 80
    assert [row[0] for row in rows] == bag.stamps_ns.tolist()
    np.testing.assert_array_equal([row[1][:3] for row in rows], bag.positions)
    np.testing.assert_array_equal([row[1][3:] for row in rows], bag.quats_xyzw)
    assert reader.strays == 0


def test_strays_are_dropped_and_a_new_run_begins_with_transforms_that_agree() -> None:
    reader, found = FramePoses("odom:base_link"), []
    messages = [message for topic, _, message in entries(0) if topic == "/tf"]
    stray = T["tf2_msgs/msg/TFMessage"]([transform(BEGIN_NS - 10**10, "odom", "base_link", (99.0, 0.0, 0.0), 0.0)])
    unstamped = T["tf2_msgs/msg/TFMessage"]([transform(0, "odom", "base_link", (99.0, 0.0, 0.0), 0.0)])
    for message in [*messages[:80], stray, unstamped, *messages[80:], *messages[:60]]:
        found += reader.rows(message, is_static=False)
    stamps = [row[0] for row in found]
    assert all(row[1][0] != 99.0 for row in found)
    assert reader.strays == 2
    again = stamps.index(BEGIN_NS, 1)
    assert stamps[:again] == [BEGIN_NS + k * 50 * MS for k in range(100)]
    assert stamps[again:] == [BEGIN_NS + k * 50 * MS for k in range(30)]


def test_one_frame_alone_is_refused() -> None:
    with pytest.raises(ConfigError, match="both frames, as PARENT:CHILD"):
        FramePoses("base_link")
