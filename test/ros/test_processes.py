"""Nodes and a user's command as processes: started, named when they end, none left."""

import signal
from pathlib import Path

import psutil
import pytest

from helpers.processes import wait_until
from sfr_loc_map.errors import ConfigError, NodeError
from sfr_loc_map.ros import processes
from sfr_loc_map.ros.processes import Supervisor, node_process, user_command


def test_a_hung_node_is_killed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with Supervisor(tmp_path) as supervisor:
        supervisor.start("monitor_node")
        monitor = supervisor.processes["monitor_node"]
        wait_until(lambda: "subscribes to" in monitor.text, "its start")
        supervisor.check()
        assert supervisor.restart_crashed() == []
        monitor.send(signal.SIGSTOP)  # it does not react to SIGINT and SIGTERM any more
        quick = ((signal.SIGINT, 0.3), (signal.SIGTERM, 0.3), (signal.SIGKILL, 5.0))
        monkeypatch.setattr(processes, "ESCALATION", quick)
    assert monitor.popen.poll() == -signal.SIGKILL


def test_a_node_that_is_ended_while_python_starts_says_nothing(tmp_path: Path) -> None:
    """An interrupt within the first modules of Python would be a traceback."""
    for _ in range(3):
        node = node_process("nodes.monitor_node", (), tmp_path)
        node.send(signal.SIGINT)
        assert node.popen.wait(60) == 0
    assert node.text == ""


def test_a_node_that_ends_without_an_error_is_named_as_well(tmp_path: Path) -> None:
    with Supervisor(tmp_path) as supervisor:
        supervisor.start("monitor_node")
        supervisor.processes["monitor_node"].send(signal.SIGTERM)
        with pytest.raises(NodeError, match="monitor_node ended with exit code 0"):
            wait_until(lambda: supervisor.check(), "the end of the node")


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
    routine = "[INFO] [1.0] [node]: subscribes to /a"
    for words, last_line in (("echo the warning;", "the warning"), ("", "its log has no error")):
        (tmp_path / "external.log").unlink()
        with user_command(f"sh -c '{words} echo \"{routine}\"; kill -9 $$'", tmp_path) as process:
            wait_until(lambda: process.ending, "its end")
            assert (process.ending, process.last_log_line) == ("was killed by SIGKILL", last_line)
    with user_command("sh -c 'sleep 100 & sleep 100'", tmp_path) as process:
        children = wait_until(lambda: psutil.Process(process.popen.pid).children()[1:], "its children")
        assert not process.ending
    psutil.wait_procs(children, timeout=60)
    assert not any(child.is_running() for child in children)
    for command, words in (("", "is empty"), ("a 'quote", "No closing quotation"), ("/no/program", "cannot start")):
        with pytest.raises(ConfigError, match=words), user_command(command, tmp_path):
            pass
