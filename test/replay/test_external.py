"""Results of an external node are only its answers to pairs of the replay."""

from __future__ import annotations

import time
from typing import Any, cast

from nav_msgs.msg import Odometry

from sfr_loc_map.message_stamps import NS_PER_S, stamp_of
from sfr_loc_map.replay.external import ExternalNode
from sfr_loc_map.replay.options import ExternalOptions
from sfr_loc_map.replay.received import ReceivedResults
from sfr_loc_map.ros.messages import header_msg
from sfr_loc_map.suite_names import Task


class Kept(ExternalNode):
    """A node whose accepted answers are kept by their stamps."""

    kind = Odometry

    def __init__(self) -> None:
        super().__init__(cast("Any", None), ExternalOptions(Task.LOCALISATION, "poses"), None, ReceivedResults())
        self._publishers = set()  # without a graph
        self.accepted_ns: list[int] = []

    def read(self, message: Odometry) -> None:
        """Read any message."""

    def accept(self, message: Odometry, content: None) -> None:
        """Keep the stamp."""
        self.accepted_ns.append(stamp_of(message))

    def answer(self, stamp_ns: int) -> None:
        """Receive an answer."""
        self._on_answer(Odometry(header=header_msg(stamp_ns, "ds"), child_frame_id="rb"))


def test_answers_whose_stamp_is_of_no_pair_are_not_used() -> None:
    node, of_pair, of_next = Kept(), NS_PER_S, 2 * NS_PER_S
    node.note_sent(of_pair, time.monotonic())
    for number in range(100):
        node.answer(of_pair + number)
    node.answer(of_next)
    assert node.accepted_ns == [of_pair], "the other answers are to no published pair"
    node.note_sent(of_next, time.monotonic())
    assert node.accepted_ns == [of_pair, of_next]
