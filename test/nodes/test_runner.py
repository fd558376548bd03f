"""The main program of a node: signals end it cleanly whenever they come, and errors are one line."""

import os
import time
from pathlib import Path
from signal import SIGINT, SIGKILL, SIGTERM

import psutil
import pytest
from processes import Process, handles_signals, wait_until

NODE = """
import sys, time
from rclpy.node import Node
from sfr_loc_map.errors import NodeError
from sfr_loc_map.nodes.runner import run

class Slow(Node):
    def __init__(self):
        super().__init__("slow")
        self.create_timer(0.01, lambda: None)
        {start}
        print("ready", flush=True)
    def destroy_node(self):
        time.sleep(0.4)
        super().destroy_node()
        print("shut down", flush=True)

code = run(Slow)
print("code", code, flush=True)
sys.exit(code)
"""


def process(folder: Path, start: str = "pass", *arguments: str) -> Process:
    script = folder / "slow_node.py"
    script.write_text(NODE.format(start=start), encoding="utf-8")
    return Process(folder / "node.log", str(script), *arguments)


SIGNALS = [(SIGINT,), (SIGTERM,), (SIGINT, SIGINT, SIGINT), (SIGTERM, SIGINT), (SIGTERM, SIGTERM)]
FORKS = """
import os, sys
import sfr_loc_map.nodes.runner
for number in range({count}):
    pid = os.fork()
    if pid == 0:
        log = os.open(f"{folder}/{{number}}.log", os.O_WRONLY | os.O_CREAT, 0o644)
        os.dup2(log, 1)
        os.dup2(log, 2)
        exec(compile(open("{script}").read(), "slow_node", "exec"))
    print(pid, flush=True)
for _ in range({count}):
    os.wait()
"""
"""Starts nodes that share the time of their imports."""


@pytest.mark.slow
def test_signals_end_a_node_cleanly_however_many(tmp_path: Path) -> None:
    script, forks_script = tmp_path / "slow_node.py", tmp_path / "forks.py"
    script.write_text(NODE.format(start="pass"), encoding="utf-8")
    forks_script.write_text(FORKS.format(count=len(SIGNALS), folder=tmp_path, script=script), encoding="utf-8")
    logs = [tmp_path / f"{number}.log" for number in range(len(SIGNALS))]
    with Process(tmp_path / "forks.log", str(forks_script)) as forks:
        for log in logs:
            wait_until(lambda log=log: log.exists() and "ready" in log.read_text(), f"{log.name} ready")
        for pid, signals in zip(map(int, forks.text.split()), SIGNALS, strict=True):
            for position, number in enumerate(signals):
                time.sleep(0.1 * (position > 0))
                os.kill(pid, number)
        assert forks.popen.wait(60) == 0
    assert [log.read_text().split("ready\n")[1] for log in logs] == ["shut down\ncode 0\n"] * len(SIGNALS)


@pytest.mark.parametrize("number", [SIGINT, SIGTERM])
def test_a_signal_while_modules_are_imported_ends_a_node_in_silence(tmp_path: Path, number: int) -> None:
    command = ("-m", "sfr_loc_map.nodes.start", "nodes.localisation_node")
    with Process(tmp_path / "node.log", *command) as node:
        wait_until(lambda: handles_signals(node.popen.pid), "the first module")
        assert node.end(number) == 0
        assert node.text == ""


def test_a_signal_while_the_node_is_being_made_ends_it_cleanly(tmp_path: Path) -> None:
    with process(tmp_path, "print('making', flush=True); time.sleep(1.0); self.create_publisher") as node:
        node.wait_for("making")
        assert node.end(SIGTERM) == 0
        assert "Traceback" not in node.text


MANAGED = """
import sys, time
from std_msgs.msg import String
from sfr_loc_map.nodes.lifecycle.managed_node import ManagedNode
from sfr_loc_map.nodes.pair_node import PairNodeConfig
from sfr_loc_map.nodes.runner import run

class Slow(ManagedNode[PairNodeConfig]):
    def __init__(self):
        super().__init__("slow", "mapping", PairNodeConfig, live=())

    def setup(self):
        print("setting up", flush=True)
        time.sleep(1.0)
        print("undisturbed", flush=True)
        self.endpoints.add_publisher(String, "x", 1)

sys.exit(run(Slow))
"""


def test_a_signal_while_the_node_is_configured_ends_it_cleanly(tmp_path: Path) -> None:
    """No exception in the middle: in a callback from C it would be discarded, and what is half made be used."""
    script = tmp_path / "managed.py"
    script.write_text(MANAGED, encoding="utf-8")
    with Process(tmp_path / "node.log", str(script)) as node:
        node.wait_for("setting up")
        assert node.end(SIGINT) == 0
        assert "undisturbed" in node.text
        assert "Traceback" not in node.text


@pytest.mark.parametrize(
    ("start", "arguments", "code", "words"),
    [
        ("raise NodeError('sought a,\\n found b')", (), 2, "slow_node: sought a, found b\ncode 2\n"),
        ("1 / 0", (), 1, "ZeroDivisionError"),
        ("pass", ("--ros-args", "--params-file", "/nowhere.yaml"), 2, "slow_node: ROS does not start"),
    ],
)
def test_errors_of_ours_are_one_line_and_exit_2_and_others_keep_their_traceback(
    tmp_path: Path, start: str, arguments: tuple[str, ...], code: int, words: str
) -> None:
    with process(tmp_path, start, *arguments) as node:
        assert node.popen.wait(60) == code
        assert words in node.text
        assert ("Traceback" in node.text) == (code == 1)


@pytest.mark.slow
def test_a_supervised_node_does_not_outlive_its_supervisor(tmp_path: Path) -> None:
    script = tmp_path / "supervisor.py"
    script.write_text(
        "import time\nfrom pathlib import Path\nfrom sfr_loc_map.nodes.processes import Supervisor\n"
        f"s = Supervisor(Path({str(tmp_path)!r}))\ns.start('monitor_node')\n"
        "print('pid', s.processes['monitor_node'].popen.pid, flush=True)\ntime.sleep(100)\n",
        encoding="utf-8",
    )
    with Process(tmp_path / "supervisor.log", str(script)) as supervisor:
        supervisor.wait_for("pid")
        node = psutil.Process(int(supervisor.text.split()[1]))
        log = tmp_path / "monitor_node.log"
        wait_until(lambda: "listens to" in log.read_text(), "start of the node")
        supervisor.end(SIGKILL)
    wait_until(lambda: not node.is_running() or node.status() == psutil.STATUS_ZOMBIE, "end of the node")
