"""The SROS2 policy allows what the nodes do, and no more."""

# ruff: noqa: E402 - ROS may be absent
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
pytestmark = pytest.mark.ros

from sfr_loc_map.nodes.lifecycle.managed_node import ManagedNode
from sfr_loc_map.nodes.localisation_node import LocalisationNode
from sfr_loc_map.nodes.mapping_node import MappingNode
from sfr_loc_map.nodes.monitor_node import MonitorNode

POLICY = Path(__file__).parents[2] / "config" / "sros2_policy.xml"
AT_TIMES = {"/tf", "/tf_static", "/clock"}
"""Only with tf2_msgs or use_sim_time."""
KINDS = {"publish": "publisher", "subscribe": "subscriber", "reply": "service", "request": "client"}


def allowed(node_name: str) -> dict[str, set[str]]:
    """Return the full names of a node's profile by what it may do with them."""
    (profile,) = ET.parse(POLICY).getroot().findall(f"enclaves/enclave/profiles/profile[@node='{node_name}']")
    names: dict[str, set[str]] = {kind: set() for kind in KINDS}
    namespace = profile.attrib["ns"]
    for group in profile:
        ((kind, verdict),) = group.attrib.items()
        assert verdict == "ALLOW"
        for item in group:
            text = item.text or ""
            if text.startswith("~"):
                text = f"{namespace}{node_name}{text[1:]}"
            names[kind].add(text if text.startswith("/") else namespace + text)
    return names


@pytest.mark.parametrize("kind", [LocalisationNode, MappingNode, MonitorNode])
def test_the_policy_is_what_the_node_does(ros: None, kind: type[ManagedNode]) -> None:
    node = kind()
    node.start()
    for action, names in allowed(node.get_name()).items():
        found = getattr(node, f"get_{KINDS[action]}_names_and_types_by_node")(node.get_name(), node.get_namespace())
        assert names - AT_TIMES == {name for name, _ in found} - AT_TIMES, action
    node.destroy_node()


def test_each_node_has_an_enclave_of_its_own_and_only_known_elements_are_used() -> None:
    root = ET.parse(POLICY).getroot()
    assert (root.tag, root.attrib) == ("policy", {"version": "0.2.0"})
    assert [enclave.attrib["path"] for enclave in root.findall("enclaves/enclave")] == [
        "/localisation",
        "/mapping",
        "/monitor",
    ]
    tags = {element.tag for element in root.iter()}
    assert tags == {"policy", "enclaves", "enclave", "profiles", "profile", "topics", "topic", "services", "service"}
