"""A node of one's own, within another program's process."""

import re
from dataclasses import dataclass
from typing import Any

from geometry_msgs.msg import PointStamped

from helpers import ROOT
from helpers.made_scene import LOC_RIG
from helpers.manager import Capture, LocalNode, Manager
from helpers.node_scenes import MOUNT, params, send_infos
from sfr_loc_map.configuration.parameters import param
from sfr_loc_map.nodes.localisation_node import LocalisationNodeConfig

PAGE = ROOT / "docs" / "nodes.md"


@dataclass(frozen=True, slots=True)
class OurConfig(LocalisationNodeConfig):
    far_m: float = param(3.0, unit="m", doc="What is far.", low=0.0, high=100.0)


def test_a_package_of_ones_own_extends_the_node_without_copying(ros: None, capfd: Capture) -> None:
    """The example of the page on the nodes, with a parameter of its own."""
    (code,) = re.findall(r"```python\n(.*?class OurLocalisation.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    example: dict[str, Any] = {"__name__": "our_localisation"}
    exec(code, example)
    kind = type("WithParameter", (example["OurLocalisation"],), {"config_type": OurConfig})
    with Manager() as peer, LocalNode(peer, capfd, kind, *MOUNT, *params("far_m:=7.0")) as node:
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
