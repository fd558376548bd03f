"""Doctor and recorder observe the complete graph of a discovery server."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from helpers.processes import PATIENCE_S, Process
from sfr_loc_map.ros import environment
from sfr_loc_map.ros.environment import see_whole_graph

SFR = ("-m", "sfr_loc_map")
ROVER = ("-m", "helpers.rover_process", "good")


def findings(folder: Path, *words: str) -> tuple[dict[str, str], str]:
    """Return the causes that the doctor finds, by topic or node, and its exit code."""
    with Process(folder / "doctor.log", *SFR, "doctor", "--json", str(folder / "d.json"), *words) as doctor:
        doctor.popen.wait(PATIENCE_S)
        report = json.loads((folder / "d.json").read_text())
        return {item["where"]: item["cause"] for item in report["issues"]}, doctor.text


@pytest.fixture
def discovery_server(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[str]:
    """The address of a discovery server of Fast DDS."""
    program = Path(sys.executable).with_name("fast-discovery-server")
    if not program.is_file():
        pytest.skip("fast-discovery-server is not installed")
    packages = Path(sys.executable).parents[1]
    libraries = [str(packages / "lib"), *map(str, packages.glob("lib/python3*/site-packages/*.libs"))]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    with (tmp_path / "server.log").open("wb") as log:
        server = subprocess.Popen(
            [program, "-i", "0", "-l", "127.0.0.1", "-p", str(port)],
            stdout=log, stderr=log, env=os.environ | {"LD_LIBRARY_PATH": ":".join(libraries)},
        )  # fmt: skip
    monkeypatch.setenv("ROS_DISCOVERY_SERVER", f"127.0.0.1:{port}")
    monkeypatch.delenv("ROS_AUTOMATIC_DISCOVERY_RANGE", raising=False)
    yield f"127.0.0.1:{port}"
    server.kill()
    server.wait()


@pytest.mark.slow
def test_doctor_and_recorder_see_the_graph_of_a_discovery_server(discovery_server: str, tmp_path: Path) -> None:
    with Process(tmp_path / "rover.log", *ROVER) as rover:
        rover.wait_for("ready")
        causes, text = findings(tmp_path, "--seconds", "1")
        assert "no_publisher" not in causes.values(), text
        assert "no_topic" not in causes.values(), text
        assert discovery_server in environment.domain()
        out = tmp_path / "bag.mcap"
        with Process(tmp_path / "record.log", *SFR, "record", str(out), "--duration", "4") as recorder:
            assert recorder.popen.wait(PATIENCE_S) == 0, recorder.text


def test_a_choice_of_the_user_about_the_discovery_server_stays() -> None:
    for given, expected in (({}, None), ({"ROS_DISCOVERY_SERVER": "a:1"}, "TRUE")):
        see_whole_graph(given)
        assert given.get("ROS_SUPER_CLIENT") == expected
    chosen = {"ROS_DISCOVERY_SERVER": "a:1", "ROS_SUPER_CLIENT": "FALSE"}
    see_whole_graph(chosen)
    assert chosen["ROS_SUPER_CLIENT"] == "FALSE"
