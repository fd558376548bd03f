"""What a replay meets and gives in the graph: nodes of other programs, the extrinsics as a frame."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import rclpy
from made_scene import T_RB_LOCSB

from sfr_loc_map.errors import NodeError
from sfr_loc_map.geometry.transform import FrameTree
from sfr_loc_map.nodes import extrinsics
from sfr_loc_map.nodes.replay.graph_node import ReplayNode


def test_a_node_of_another_program_is_the_reason_and_not_what_it_publishes() -> None:
    supervisor = SimpleNamespace(processes={"localisation_node": None}, check=lambda: None)
    with ReplayNode(supervisor) as replay:
        nodes = [rclpy.create_node("localisation_node", namespace=name) for name in ("rover1", "")]
        replay.wait_for(lambda: True, 1.0, lambda: "nothing")
        nodes.append(rclpy.create_node("localisation_node"))
        with pytest.raises(NodeError, match=r"another localisation_node is in ROS domain .*unset ROS_DOMAIN_ID"):
            replay.wait_for(pytest.fail, 1.0, lambda: "nothing")
        for node in nodes:
            node.destroy_node()


def test_the_extrinsics_are_published_as_those_who_listen_read_them(monkeypatch: pytest.MonkeyPatch) -> None:
    tree, sent, made = FrameTree(), [], []

    def create(kind: Any, topic: str, qos: Any) -> Any:
        made.append((topic, qos.durability.name))
        return SimpleNamespace(publish=sent.append)

    monkeypatch.setattr(extrinsics, "tf_message_type", lambda: SimpleNamespace)  # tf2_msgs is in no wheel
    extrinsics.publish_extrinsics(SimpleNamespace(create_publisher=create), T_RB_LOCSB)
    assert made == [("/tf_static", "TRANSIENT_LOCAL")]
    extrinsics.add_static_transforms(sent[0], tree)
    assert np.allclose(tree.find("rb", "locsb").matrix, T_RB_LOCSB.matrix, atol=1e-15)
