"""Environment variables of a process with a ROS node; variables of the user are kept."""

import socket
import subprocess
import sys
from pathlib import Path

import pytest

from sfr_loc_map.errors import NodeError
from sfr_loc_map.ros import domains, environment
from sfr_loc_map.ros.domains import DOMAINS, hold_domain


def test_what_the_user_chose_stays() -> None:
    variables = {"ROS_DOMAIN_ID": "7", "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}
    environment.isolate(variables)
    assert variables == {"ROS_DOMAIN_ID": "7", "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}
    fresh: dict[str, str] = {}
    environment.isolate(fresh)
    assert fresh["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"
    assert int(fresh["ROS_DOMAIN_ID"]) in DOMAINS


def test_no_two_programs_choose_one_domain() -> None:
    """A domain is refused in every process while it is held or has a participant, and is free again afterwards."""
    with hold_domain() as domain:
        number = domain.number
        code = f"from sfr_loc_map.ros.domains import hold_domain; hold_domain([{number}])"
        other = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
        assert f"NodeError: all ROS domains from {number} to {number} are in use" in other.stderr
    with hold_domain([number]):
        pass
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as participant:
        participant.bind(("127.0.0.1", 7400 + 250 * number + 12))
        with pytest.raises(NodeError, match="set ROS_DOMAIN_ID"):
            hold_domain([number])


def test_a_domain_with_ports_in_the_shared_memory_is_chosen_last(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """These belong to a killed process, or to one of a container that shares only the memory of this host."""
    monkeypatch.setattr(domains, "SHARED_MEMORY", tmp_path)
    with hold_domain() as first, hold_domain() as second:
        pair = first.number, second.number
    (tmp_path / f"fastrtps_port{7400 + 250 * pair[0] + 11}").touch()
    (tmp_path / f"fastrtps_port{7400 + 250 * pair[1] + 250}").touch()  # of the domain after it
    for _ in range(10):
        with hold_domain(pair) as chosen:
            assert chosen.number == pair[1]
    with hold_domain([pair[0]]):
        pass


def test_fast_dds_of_both_versions_gets_the_same_profile() -> None:
    for given, expected in (("", str(environment.PROFILE)), ("/own.xml", "/own.xml")):
        for named in environment.PROFILE_VARIABLES:
            variables = {named: given}
            environment.prepare(variables)
            assert [variables[name] for name in environment.PROFILE_VARIABLES] == [expected] * 2


def test_the_profile_of_fast_dds_is_where_the_variables_point() -> None:
    assert environment.PROFILE.is_file()
    variables: dict[str, str] = {}
    environment.prepare(variables)
    assert {variables[name] for name in environment.PROFILE_VARIABLES} == {str(environment.PROFILE)}


def test_transports_of_the_user_are_not_replaced_by_the_profile() -> None:
    for given in ({}, {environment.PROFILE_VARIABLES[0]: ""}, {environment.PROFILE_VARIABLES[1]: "/own.xml"}):
        variables = {environment.TRANSPORTS_VARIABLE: "UDPv4", **given}
        environment.prepare(variables)
        profiles = {variables.get(name) for name in environment.PROFILE_VARIABLES}
        assert profiles == ({"/own.xml"} if "/own.xml" in given.values() else {None})


@pytest.mark.parametrize(("wanted", "is_installed"), [("", True), ("rmw_fastrtps_cpp", True), ("rmw_other_cpp", False)])
def test_a_middleware_that_is_not_installed_is_named(
    monkeypatch: pytest.MonkeyPatch, wanted: str, is_installed: bool
) -> None:
    monkeypatch.setattr("ament_index_python.get_resources", lambda kind: {"rmw_fastrtps_cpp": "/opt/ros"})
    if is_installed:
        environment.check_middleware({"RMW_IMPLEMENTATION": wanted})
        return
    with pytest.raises(NodeError, match=wanted):
        environment.check_middleware({"RMW_IMPLEMENTATION": wanted})
