"""Results of an external node are only its answers to pairs of the replay."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any, cast

from nav_msgs.msg import Odometry

from sfr_loc_map.message_stamps import NS_PER_S, stamp_of
from sfr_loc_map.replay.external import ExternalNode
from sfr_loc_map.replay.options import ExternalOptions
from sfr_loc_map.ros.messages import header_msg
from sfr_loc_map.suite_names import Task


class Kept:
    """A converter that keeps the stamps of the accepted answers."""

    kind = Odometry

    def __init__(self) -> None:
        self.accepted_ns: list[int] = []

    def frames_of(self, message: Odometry) -> str:
        """Return the frames of any message."""
        return f"{message.header.frame_id} -> {message.child_frame_id}"

    def read(self, message: Odometry) -> None:
        """Read any message."""

    def accept(self, message: Odometry, content: None) -> None:
        """Keep the stamp."""
        self.accepted_ns.append(stamp_of(message))


def test_answers_whose_stamp_is_of_no_pair_are_not_used() -> None:
    kept, of_pair, of_next = Kept(), NS_PER_S, 2 * NS_PER_S
    graph = SimpleNamespace(get_publishers_info_by_topic=lambda topic: [])
    peer = cast("Any", SimpleNamespace(ros_node=graph))
    node = ExternalNode(peer, ExternalOptions(Task.LOCALISATION, "poses"), None, kept, name="n", watch=None)

    def answer(stamp_ns: int) -> None:
        node.receive(Odometry(header=header_msg(stamp_ns, "ds"), child_frame_id="rb"))

    node.note_sent(of_pair, time.monotonic())
    for number in range(100):
        answer(of_pair + number)
    answer(of_next)
    assert kept.accepted_ns == [of_pair], "the other answers are to no published pair"
    node.note_sent(of_next, time.monotonic())
    assert kept.accepted_ns == [of_pair, of_next]
