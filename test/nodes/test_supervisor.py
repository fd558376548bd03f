# ruff: noqa: E402 - ROS may be absent
import signal
import time
from pathlib import Path

import pytest
from processes import wait_until

pytest.importorskip("rclpy")
pytestmark = pytest.mark.ros

from sfr_loc_map.errors import NodeError
from sfr_loc_map.nodes.process import supervisor as module
from sfr_loc_map.nodes.process.supervisor import Supervisor


def test_a_node_that_ends_is_named_with_its_last_words(tmp_path: Path) -> None:
    with Supervisor(tmp_path) as supervisor:
        supervisor.start("monitor_node", ["--ros-args", "-p", "limits_file:=/nowhere.yaml"])
        with pytest.raises(NodeError, match=r"monitor_node ended with exit code 2: monitor_node: .*'/nowhere.yaml'"):
            wait_until(lambda: supervisor.check(), "the end of the node")


def test_a_killed_node_is_named_and_the_others_are_ended(tmp_path: Path) -> None:
    with Supervisor(tmp_path) as supervisor:
        for name in ("monitor_node", "mapping_node"):
            supervisor.start(name)
        for name in supervisor.pids:
            wait_until(lambda name=name: "listens to" in (tmp_path / f"{name}.log").read_text(), f"start of {name}")
        supervisor.check()
        processes = [process.popen for process in supervisor._processes]
        processes[0].send_signal(signal.SIGKILL)
        processes[0].wait()
        with pytest.raises(NodeError, match="monitor_node was killed by SIGKILL"):
            supervisor.check()
    assert [process.poll() for process in processes] == [-signal.SIGKILL, 0]


def test_a_node_that_does_not_listen_is_killed_within_the_bound(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "ESCALATION", ((signal.SIGINT, 0.3), (signal.SIGTERM, 0.3), (signal.SIGKILL, 5.0)))
    with Supervisor(tmp_path) as supervisor:
        supervisor.start("monitor_node")
        wait_until(lambda: "listens to" in (tmp_path / "monitor_node.log").read_text(), "start")
        popen = supervisor._processes[0].popen
        popen.send_signal(signal.SIGSTOP)
        begin = time.monotonic()
    assert popen.poll() == -signal.SIGKILL
    assert time.monotonic() - begin < 5.0
