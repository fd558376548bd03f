"""The replay in the ROS graph: nodes of other programs, and the extrinsics as a frame."""

from types import SimpleNamespace

import pytest
import rclpy

from sfr_loc_map.errors import NodeError
from sfr_loc_map.replay.replay_peer import ReplayPeer


def test_a_node_of_another_program_is_the_reason_and_not_what_it_publishes() -> None:
    supervisor = SimpleNamespace(processes={"localisation_node": None}, check=lambda: None)
    with ReplayPeer(supervisor) as replay:
        nodes = [rclpy.create_node("localisation_node", namespace=name) for name in ("rover1", "")]
        replay.wait_for(lambda: True, 1.0, lambda: "nothing")
        nodes.append(rclpy.create_node("localisation_node"))
        with pytest.raises(NodeError, match=r"another localisation_node is in ROS domain .*unset ROS_DOMAIN_ID"):
            replay.wait_for(pytest.fail, 1.0, lambda: "nothing")
        for node in nodes:
            node.destroy_node()
