"""Nodes and a user's command as processes: started, named when they end, and nothing of them left."""

import re
import signal
import time
from pathlib import Path

import psutil
import pytest
from processes import wait_until

from sfr_loc_map.errors import ConfigError, NodeError
from sfr_loc_map.nodes import processes
from sfr_loc_map.nodes.processes import Supervisor, node_names, user_command


def segments(pid: int) -> set[Path]:
    """Return the segments of Fast DDS that a process has made, with their lock files."""
    links = [link.resolve() for link in Path(f"/proc/{pid}/fd").iterdir()]
    locks = {link for link in links if re.fullmatch(r"/dev/shm/fastrtps_[0-9a-f]+_el", str(link))}
    return locks | {lock.with_name(lock.name.removesuffix("_el")) for lock in locks}


def test_tasks_choose_nodes_each_once() -> None:
    everything = ["localisation_node", "mapping_node", "monitor_node"]
    assert node_names([]) == node_names(["all"]) == node_names(["monitor", "all"]) == everything
    assert node_names(["monitor", "localisation", "monitor"]) == ["localisation_node", "monitor_node"]
    with pytest.raises(ConfigError, match="'mapper' is not a node"):
        node_names(["mapper"])


@pytest.mark.slow
def test_killed_nodes_are_named_or_restarted_hung_ones_are_killed_and_none_is_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with Supervisor(tmp_path) as supervisor:
        supervisor.start("monitor_node")
        supervisor.start("mapping_node")
        monitor, mapping = supervisor.processes.values()
        for process in (monitor, mapping):
            wait_until(lambda process=process: "listens to" in process.text, f"start of {process.name}")
        supervisor.check()
        assert supervisor.restart_crashed() == []
        first, left, own = monitor.popen, segments(monitor.popen.pid), segments(mapping.popen.pid)
        assert all(path.exists() for path in left | own)
        supervisor.note_segments()
        monitor.kill()
        with pytest.raises(NodeError, match="monitor_node was killed by SIGKILL"):
            supervisor.check()
        assert supervisor.restart_crashed() == ["monitor_node was killed by SIGKILL"]
        assert not any(path.exists() for path in left)
        assert all(path.exists() for path in own)
        assert monitor.popen.pid != first.pid
        wait_until(lambda: monitor.text.count("listens to") == 2, "restart of the monitor")
        monitor.send(signal.SIGINT)
        assert monitor.wait(60.0) == 0
        mapping.send(signal.SIGSTOP)  # it does not react to SIGINT and SIGTERM any more
        quick = ((signal.SIGINT, 0.3), (signal.SIGTERM, 0.3), (signal.SIGKILL, 5.0))
        monkeypatch.setattr(processes, "ESCALATION", quick)
        begin = time.monotonic()
    assert time.monotonic() - begin < 10.0
    assert mapping.exit_code == -signal.SIGKILL
    assert left
    assert not any(path.exists() for path in own)


def test_a_node_that_cannot_start_is_named_with_its_last_log_line(tmp_path: Path) -> None:
    with Supervisor(tmp_path) as supervisor:
        supervisor.start("monitor_node", ["--ros-args", "-p", "limits_file:=/nowhere.yaml"])
        with pytest.raises(NodeError, match=r"monitor_node ended with exit code 2: monitor_node: .*'/nowhere.yaml'"):
            wait_until(lambda: supervisor.check(), "the end of the node")
        with pytest.raises(NodeError, match="ended with exit code 2"):
            supervisor.restart_crashed()  # a restart would not help


def test_a_command_says_how_it_ended_and_what_it_started_ends_with_it(tmp_path: Path) -> None:
    with user_command("sh -c 'echo first; echo \"the reason\" >&2; exit 4'", tmp_path) as process:
        wait_until(lambda: process.ending, "its end")
        assert (process.name, process.ending, process.last_log_line) == ("sh", "ended with exit code 4", "the reason")
        assert process.text == "first\nthe reason\n"
    with user_command("sh -c 'sleep 100 & sleep 100'", tmp_path) as process:
        children = wait_until(lambda: psutil.Process(process.popen.pid).children()[1:], "its children")
        assert not process.ending
    psutil.wait_procs(children, timeout=10)
    assert not any(child.is_running() for child in children)
    for command, words in (("", "is empty"), ("a 'quote", "No closing quotation"), ("/no/program", "cannot start")):
        with pytest.raises(ConfigError, match=words), user_command(command, tmp_path):
            pass
