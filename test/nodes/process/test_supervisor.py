# ruff: noqa: E402 - ROS may be absent
import signal
import time
from pathlib import Path

import pytest
from processes import segments_of, wait_until

pytest.importorskip("rclpy")
pytestmark = pytest.mark.ros

from sfr_loc_map.errors import ConfigError, NodeError
from sfr_loc_map.nodes.process import supervisor as module
from sfr_loc_map.nodes.process.shared_segments import remove_ownerless, segment_locks
from sfr_loc_map.nodes.process.supervisor import Supervisor, node_names


def start(supervisor: Supervisor, *names: str) -> None:
    for name in names:
        supervisor.start(name)
    for name, process in supervisor.processes.items():
        wait_until(lambda process=process: "listens to" in process.text, f"start of {name}")


def test_tasks_choose_nodes_each_once() -> None:
    everything = ["localisation_node", "mapping_node", "monitor_node"]
    assert node_names([]) == node_names(["all"]) == node_names(["monitor", "all"]) == everything
    assert node_names(["monitor", "localisation", "monitor"]) == ["localisation_node", "monitor_node"]
    with pytest.raises(ConfigError, match="'mapper' is not a node"):
        node_names(["mapper"])


@pytest.mark.slow
def test_a_node_that_ends_is_named_with_its_last_log_line(tmp_path: Path) -> None:
    with Supervisor(tmp_path) as supervisor:
        supervisor.start("monitor_node", ["--ros-args", "-p", "limits_file:=/nowhere.yaml"])
        with pytest.raises(NodeError, match=r"monitor_node ended with exit code 2: monitor_node: .*'/nowhere.yaml'"):
            wait_until(lambda: supervisor.check(), "the end of the node")
        with pytest.raises(NodeError, match="ended with exit code 2"):
            supervisor.restart_crashed()  # a restart would not help


@pytest.mark.slow
def test_killed_nodes_are_named_or_restarted_hung_ones_are_killed_and_none_is_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with Supervisor(tmp_path) as supervisor:
        start(supervisor, "monitor_node", "mapping_node")
        supervisor.check()
        assert supervisor.restart_crashed() == []
        monitor, mapping = supervisor.processes.values()
        first, before = monitor.popen, monitor.text.count("listens to")
        left = segment_locks(first.pid)
        supervisor.note_segments()
        monitor.kill()
        assert left
        assert all(path.exists() for path in left)
        with pytest.raises(NodeError, match="monitor_node was killed by SIGKILL"):
            supervisor.check()
        assert supervisor.restart_crashed() == ["monitor_node was killed by SIGKILL"]
        assert not any(path.exists() for path in left)
        supervisor.check()
        assert monitor.popen.pid != first.pid
        wait_until(lambda: monitor.text.count("listens to") == before + 1, "restart of the monitor")
        monitor.send(signal.SIGINT)
        assert monitor.wait(60.0) == 0
        own = segment_locks(mapping.popen.pid)
        segments = [lock.with_name(lock.name.removesuffix("_el")) for lock in own]
        assert segments
        assert set(segments) <= segments_of([mapping.popen.pid])
        remove_ownerless(own)  # it lives
        assert all(path.exists() for path in (*own, *segments))
        mapping.send(signal.SIGSTOP)  # it does not react to SIGINT and SIGTERM any more
        monkeypatch.setattr(module, "ESCALATION", ((signal.SIGINT, 0.3), (signal.SIGTERM, 0.3), (signal.SIGKILL, 5.0)))
        begin = time.monotonic()
    assert time.monotonic() - begin < 10.0
    assert mapping.exit_code == -signal.SIGKILL
    assert not any(path.exists() for path in (*own, *segments))
