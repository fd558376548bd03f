import socket
from collections import deque
from pathlib import Path
from xml.etree import ElementTree

import pytest

from sfr_loc_map.errors import NodeError
from sfr_loc_map.nodes import environment


def test_profile_is_set_where_missing_or_empty_and_the_users_own_stays() -> None:
    for given, expected in (({}, str(environment.PROFILE)), ({"x": ""}, str(environment.PROFILE))):
        variables = {environment.PROFILE_VARIABLE: given["x"]} if "x" in given else {}
        environment.prepare(variables)
        assert variables[environment.PROFILE_VARIABLE] == expected
    mine = {environment.PROFILE_VARIABLE: "/mine.xml", "AMENT_PREFIX_PATH": "/ros"}
    environment.prepare(mine)
    assert mine == {environment.PROFILE_VARIABLE: "/mine.xml", "AMENT_PREFIX_PATH": "/ros"}


def test_the_variable_is_the_one_that_this_fast_dds_reads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(environment.sys, "prefix", str(tmp_path))
    prefixes = {"AMENT_PREFIX_PATH": f"/nowhere:{tmp_path / 'ros'}"}
    assert environment.profile_variable(prefixes) == "FASTRTPS_DEFAULT_PROFILES_FILE"
    (tmp_path / "ros" / "share" / "fastdds").mkdir(parents=True)
    assert environment.profile_variable(prefixes) == "FASTDDS_DEFAULT_PROFILES_FILE"
    monkeypatch.setattr(environment, "PROFILE_VARIABLE", "FASTDDS_DEFAULT_PROFILES_FILE")
    mine = {"FASTRTPS_DEFAULT_PROFILES_FILE": "/mine.xml"}
    environment.prepare(mine)
    assert mine["FASTDDS_DEFAULT_PROFILES_FILE"] == "/mine.xml"


def test_profile_has_a_segment_that_holds_clouds_and_keeps_the_network() -> None:
    root = ElementTree.parse(environment.PROFILE).getroot()
    name = "{http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles}"
    kinds = {item.findtext(f"{name}type"): item for item in root.iter(f"{name}transport_descriptor")}
    assert set(kinds) == {"SHM", "UDPv4"}
    assert int(kinds["SHM"].findtext(f"{name}segment_size") or 0) == 64 * 2**20
    used = {item.text for item in root.find(f".//{name}userTransports") or ()}
    assert used == {item.findtext(f"{name}transport_id") for item in kinds.values()}


def test_isolate_keeps_what_the_user_chose() -> None:
    variables = {"ROS_DOMAIN_ID": "7", "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}
    environment.isolate(variables)
    assert variables == {"ROS_DOMAIN_ID": "7", "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}
    fresh: dict[str, str] = {}
    environment.isolate(fresh)
    assert 1 <= int(fresh["ROS_DOMAIN_ID"]) <= environment.DOMAINS
    assert fresh["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"


@pytest.mark.parametrize("participant", [0, 3])
def test_a_domain_in_use_is_not_chosen(monkeypatch: pytest.MonkeyPatch, participant: int) -> None:
    monkeypatch.setattr(environment, "_held", deque())
    free = environment.free_domain()
    monkeypatch.setattr(environment.random, "sample", lambda *_: [free])
    with pytest.raises(NodeError, match="ROS domains 1 to 101 are in use"):
        environment.free_domain()  # another process that asks before the first has participants
    environment._held.pop().close()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("", 7400 + 250 * free + 10 + 2 * participant))
        with pytest.raises(NodeError, match="ROS domains 1 to 101 are in use"):
            environment.free_domain()
    assert environment.free_domain() == free
    environment._held.pop().close()
