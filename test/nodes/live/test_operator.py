"""What an operator asks of the nodes."""

# ruff: noqa: E402 - ROS may be absent
from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor

import pytest

rclpy = pytest.importorskip("rclpy")
pytestmark = pytest.mark.ros

from std_srvs.srv import Trigger

from sfr_loc_map.errors import NodeError
from sfr_loc_map.live.hub import Action, Command
from sfr_loc_map.nodes.live.operator import RosOperator


def test_a_command_without_an_answer_ends_with_the_page(ros: None) -> None:
    node = rclpy.create_node("page")
    node.create_service(Trigger, "mapping_node/reset", lambda _, response: response)  # nobody spins it
    operator, begin = RosOperator(node), time.monotonic()
    with ThreadPoolExecutor(1) as pool:
        asked = pool.submit(operator.run, Command(Action.RESET, "mapping_node"))
        time.sleep(0.3)
        operator.close()
        with pytest.raises(NodeError, match="the page has ended"):
            asked.result(5.0)
    assert time.monotonic() - begin < 5.0
    node.destroy_node()
