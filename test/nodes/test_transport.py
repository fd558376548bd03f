"""What the transport lost: counted from the publishers' numbers, and over DDS by the monitor."""

import json
from pathlib import Path
from signal import SIGCONT, SIGSTOP
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfr_loc_map.pipeline.online.transport_gaps import TransportGaps

PERIOD_NS = 20_000_000
MANY, KEPT = 200, 5
"""Poses that are sent, and how many the monitor has room for."""


def lost(numbers: list[int | None]) -> int:
    gaps = TransportGaps()
    for number in numbers:
        gaps.add({"publication_sequence_number": number})
    return gaps.lost


@given(st.integers(1, 10_000), st.lists(st.booleans(), min_size=1, max_size=50))
def test_every_gap_between_two_messages_that_came_counts(first: int, came: list[bool]) -> None:
    numbers: list[int | None] = [first, *(first + 1 + i for i, there in enumerate(came) if there)]
    last = numbers[-1]
    assert last is not None
    assert lost(numbers) == last - first + 1 - len(numbers)


def test_a_publisher_that_begins_anew_lost_nothing() -> None:
    assert lost([7, 8, 10, 1, 2, 4]) == 2


def test_a_middleware_without_numbers_counts_nothing() -> None:
    assert lost([None, None, None]) == 0
    assert lost([0, 0]) == 0


@pytest.mark.ros
@pytest.mark.timeout(240)
def test_the_monitor_counts_the_poses_that_it_had_no_room_for(ros: None, tmp_path: Path) -> None:
    from diagnostic_msgs.msg import DiagnosticArray
    from nav_msgs.msg import Odometry
    from processes import ReferenceMethod, node_process
    from scenes import raw
    from std_msgs.msg import String

    from sfr_loc_map.io import bag_messages
    from sfr_loc_map.nodes.diagnostics.key_values import values_of

    arguments = [
        "--ros-args",
        "-p",
        f"input_depth:={KEPT}",
        "-p",
        "publish_period_s:=0.1",
        "-p",
        "health.period_s:=0.2",
    ]
    with node_process(tmp_path, "monitor_node", *arguments) as monitor, ReferenceMethod() as peer:
        diagnostics = peer.listen(DiagnosticArray, "/diagnostics")
        reports = peer.listen(String, "metrics/report", latched=True)
        monitor.wait_for("listens to")

        def send(number: int, topic: str = "localisation/odometry") -> None:
            position, turn = np.array([0.01 * number, 0.0, 0.0]), np.array([0.0, 0.0, 0.0, 1.0])
            message = bag_messages.odometry((number + 1) * PERIOD_NS, position, turn)
            peer.publish(Odometry, topic, raw(message))

        def scored() -> int:
            score: dict[str, Any] = json.loads(reports[-1].data) if reports else {}
            return int(score.get("trajectory", {}).get("estimate_poses", 0))

        def counted() -> int:
            found = [status for array in diagnostics for status in array.status if status.name.endswith(": health")]
            values = values_of(found[-1]) if found else {}
            return sum(int(value) for name, value in values.items() if name.startswith("dropped_"))

        send(0, "ground_truth/odometry")
        send(0)
        peer.until(lambda: scored() == 1, "the first pose in the score")
        monitor.popen.send_signal(SIGSTOP)
        for number in range(1, MANY):
            send(number)
        monitor.popen.send_signal(SIGCONT)
        peer.until(lambda: scored() + counted() == MANY, "the others, in the score or counted")
        assert counted() > 0
