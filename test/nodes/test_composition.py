"""Nodes within another program's process."""

import weakref
from dataclasses import dataclass
from pathlib import Path

from geometry_msgs.msg import PointStamped, PoseStamped
from made_scene import LOC_RIG, NAV_RIG, loc_pair, nav_pair
from nav_msgs.msg import Odometry
from our_localisation import OurLocalisation
from peers import Capture, LocalNode, Manager
from scenes import MOUNT, calls, params, raw, send_infos, send_pair
from sensor_msgs.msg import PointCloud2

from sfr_loc_map.config import param
from sfr_loc_map.io import bag_messages
from sfr_loc_map.nodes.localisation_node import LocalisationNode, LocalisationNodeConfig
from sfr_loc_map.nodes.mapping_node import MappingNode

ROVER = ["-r", "__ns:=/rover"]


def test_two_nodes_share_a_process_and_cleanup_frees_what_they_held(ros: None, capfd: Capture) -> None:
    with (
        Manager() as peer,
        LocalNode(peer, capfd, LocalisationNode, *MOUNT, *ROVER) as first,
        LocalNode(peer, capfd, MappingNode, *ROVER, *params("pairs_per_map:=2")) as second,
    ):
        localisation, mapping = first.node, second.node
        odometry = peer.listen(Odometry, "/rover/localisation/odometry")
        clouds = peer.listen(PointCloud2, "/rover/mapping/points")
        send_infos(peer, "loc", LOC_RIG, "/rover/")
        send_infos(peer, "nav", NAV_RIG, "/rover/")
        for index in range(2):
            send_pair(peer, "loc", loc_pair(index), "/rover/")
            item = nav_pair(index)
            pose = bag_messages.pose(item.pair.stamp_ns, item.T_lm_navsb)
            peer.publish(PoseStamped, "/rover/nav/pose", raw(pose))
            send_pair(peer, "nav", item.pair, "/rover/")
        peer.until(lambda: (len(odometry), len(clouds), len(calls(peer.diagnostics))) == (2, 1, 5), "all results")
        held = (localisation._session._localiser, mapping._session._mapper, mapping.worker)
        held = [weakref.ref(item) for item in held]
        for node in (localisation, mapping):
            node.trigger_deactivate()
            node.trigger_cleanup()
            assert node.state == "unconfigured"
        peer.spin(0.1)
        assert [item() for item in held] == [None, None, None]


@dataclass(frozen=True, slots=True)
class OurConfig(LocalisationNodeConfig):
    far_m: float = param(3.0, unit="m", doc="What is far.", low=0.0, high=100.0)


class WithParameter(OurLocalisation):
    config_type = OurConfig


def test_a_package_of_ones_own_extends_the_node_without_copying(ros: None, capfd: Capture) -> None:
    """The example of the page on the nodes, with a parameter of its own."""
    page = (Path(__file__).parents[2] / "docs" / "nodes.md").read_text(encoding="utf-8")
    example = Path(__file__).with_name("our_localisation.py").read_text(encoding="utf-8")
    assert f"```python\n{example}```" in page
    with Manager() as peer, LocalNode(peer, capfd, WithParameter, *MOUNT, *params("far_m:=7.0")) as node:
        assert node.node.config.far_m == 7.0
        positions = peer.listen(PointStamped, "our/position")
        assert peer.call("localisation_node/where").message == "nowhere yet"
        send_infos(peer, "loc", LOC_RIG)
        for index in range(3):
            peer.play(index)
        peer.until(lambda: len(positions) == 3, "positions")
        for message, position in zip(peer.odometry, positions, strict=True):
            assert message.pose.pose.position == position.point
        assert peer.call("localisation_node/where").message.startswith("at [")
