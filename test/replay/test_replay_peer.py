"""The replay in the ROS graph: nodes of other programs, and the extrinsics as a frame."""

from types import SimpleNamespace

import pytest
import rclpy
from std_srvs.srv import Trigger

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


def test_a_service_that_reports_failure_fails_the_replay() -> None:
    def answer(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = is_good, "failed: no pair is complete"
        return response

    supervisor = SimpleNamespace(processes={}, check=lambda: None)
    with ReplayPeer(supervisor) as replay:
        service = replay.ros_node.create_service(Trigger, "mapping_node/finish", answer)
        is_good = True
        text = replay.call_trigger("mapping_node/finish", "mapping_node did not finish its map")
        assert text == "failed: no pair is complete"
        is_good = False
        with pytest.raises(NodeError, match=r"mapping_node did not finish its map: failed: no pair is complete"):
            replay.call_trigger("mapping_node/finish", "mapping_node did not finish its map")
        replay.ros_node.destroy_service(service)
