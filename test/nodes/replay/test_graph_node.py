"""What a replay meets and gives in the graph: nodes of other programs, the extrinsics as a frame."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import rclpy
from made_scene import T_RB_LOCSB
from std_msgs.msg import String

from sfr_loc_map.errors import InputError, NodeError
from sfr_loc_map.geometry.transform import FrameTree
from sfr_loc_map.nodes import extrinsics
from sfr_loc_map.nodes.replay import graph_node
from sfr_loc_map.nodes.replay.graph_node import PAGE_TOPICS, ReplayNode


def refuse() -> bool:
    """Fail as a replay does whose node of another program refuses the input."""
    raise InputError("the extrinsics of the stereo rig are not known")


def test_a_node_of_another_program_is_the_reason_and_not_what_it_publishes() -> None:
    supervisor = SimpleNamespace(processes={"localisation_node": None}, check=lambda: None)
    with ReplayNode(supervisor) as replay:
        nodes = [rclpy.create_node("localisation_node", namespace=name) for name in ("rover1", "")]
        replay.wait_for(lambda: True, 1.0, lambda: "nothing")
        nodes.append(rclpy.create_node("localisation_node"))
        with pytest.raises(NodeError, match=r"another localisation_node is in ROS domain .*unset ROS_DOMAIN_ID"):
            replay.wait_for(refuse, 1.0, lambda: "nothing")
        for node in nodes:
            node.destroy_node()


def page_node(name: str, *topics: str) -> Any:
    node = rclpy.create_node(name)
    for topic in topics:
        node.create_subscription(String, topic, lambda _: None, 10)
    return node


class SlowPage:
    """A page whose node appears in the graph the fifth time that its name is asked for, with some topics."""

    def __init__(self, *topics: str) -> None:
        self.topics, self.asked, self.node = topics, 0, None

    @property
    def node_name(self) -> str:
        self.asked += 1
        if self.asked == 5:
            self.node = page_node("sfr_live_7", *self.topics)
        return "sfr_live_7"


def test_a_replay_waits_for_its_page_and_for_no_other(monkeypatch: pytest.MonkeyPatch) -> None:
    with ReplayNode(SimpleNamespace(processes={}, check=lambda: None)) as replay:
        other = page_node("sfr_live_8", *PAGE_TOPICS)
        page, deaf = SlowPage(*PAGE_TOPICS), SlowPage(PAGE_TOPICS[0])
        assert replay.wait_for_page(page)
        assert page.asked >= 5
        page.node.destroy_node()
        monkeypatch.setattr(graph_node, "PAGE_TIMEOUT_S", 0.4)
        assert not replay.wait_for_page(deaf)
        assert replay.wait_for_page(SimpleNamespace(node_name=""))  # it has ended
        for node in (other, deaf.node):
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
