"""The SROS2 policy allows what the nodes do, and no more."""

import xml.etree.ElementTree as ET
from fnmatch import filter as matching
from fnmatch import fnmatchcase

import pytest

from helpers import ROOT
from sfr_loc_map.nodes.lifecycle.managed_node import ManagedNode
from sfr_loc_map.nodes.localisation_node import LocalisationNode
from sfr_loc_map.nodes.mapping_node import MappingNode
from sfr_loc_map.nodes.monitor_node import MonitorNode

POLICY = ET.parse(ROOT / "config" / "sros2_policy.xml").getroot()
AT_TIMES = {"/tf", "/tf_static", "/clock"}
"""Only with tf2_msgs or use_sim_time."""
KINDS = {"publish": "publisher", "subscribe": "subscriber", "reply": "service", "request": "client"}


def allowed(node_name: str) -> dict[str, set[str]]:
    """Return the full names of a node's profile, or patterns of names, by what it may do with them."""
    (profile,) = POLICY.findall(f"enclaves/enclave/profiles/profile[@node='{node_name}']")
    names: dict[str, set[str]] = {kind: set() for kind in KINDS}
    namespace = profile.attrib["ns"]
    for group in profile:
        ((kind, verdict),) = group.attrib.items()
        assert verdict == "ALLOW"
        for item in group:
            text = item.text.replace("~", f"{namespace}{node_name}")
            names[kind].add(text if text.startswith("/") else namespace + text)
    return names


@pytest.mark.parametrize("kind", [LocalisationNode, MappingNode, MonitorNode])
def test_the_policy_is_what_the_node_does(ros: None, kind: type[ManagedNode]) -> None:
    assert (POLICY.tag, POLICY.attrib) == ("policy", {"version": "0.2.0"})
    enclaves = [enclave.attrib["path"] for enclave in POLICY.findall("enclaves/enclave")]
    assert enclaves == ["/localisation", "/mapping", "/monitor"]
    node = kind()
    node.start()
    for action, patterns in allowed(node.get_name()).items():
        found = getattr(node, f"get_{KINDS[action]}_names_and_types_by_node")(node.get_name(), node.get_namespace())
        names = {name for name, _ in found} - AT_TIMES
        assert {name for name in names if not any(fnmatchcase(name, each) for each in patterns)} == set(), action
        assert {each for each in patterns - AT_TIMES if not matching(names, each)} == set(), action
    node.destroy_node()
