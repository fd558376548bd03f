"""A node of one's own, within another program's process."""

from dataclasses import dataclass
from pathlib import Path

from geometry_msgs.msg import PointStamped
from made_scene import LOC_RIG
from our_localisation import OurLocalisation
from peers import Capture, LocalNode, Manager
from scenes import MOUNT, params, send_infos

from sfr_loc_map.config import param
from sfr_loc_map.nodes.localisation_node import LocalisationNodeConfig


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
