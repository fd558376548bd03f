"""The main program of a node: signals end it cleanly whenever they come, and errors are one line."""

from contextlib import ExitStack
from pathlib import Path
from signal import SIGINT, SIGTERM

import pytest

from helpers.processes import Process, handles_signals, wait_until

NODE = """
import sys, time
from rclpy.node import Node
from sfr_loc_map.errors import NodeError
from sfr_loc_map.nodes.lifecycle.runner import run

class Slow(Node):
    def __init__(self):
        super().__init__("slow")
        self.create_timer(0.01, lambda: None)
        START
        print("ready", flush=True)
    def fail(self):
        raise NodeError("after the start")
    def destroy_node(self):
        time.sleep(0.4)
        super().destroy_node()
        print("shut down", flush=True)

code = run(Slow)
print("code", code, flush=True)
sys.exit(code)
"""
MANAGED = """
import sys, time
from std_msgs.msg import String
from sfr_loc_map.nodes.lifecycle.managed_node import ManagedNode
from sfr_loc_map.nodes.pair_node import PairNodeConfig
from sfr_loc_map.nodes.lifecycle.runner import run

class Slow(ManagedNode[PairNodeConfig]):
    task, config_type = "mapping", PairNodeConfig

    def __init__(self):
        super().__init__("slow")

    def setup(self):
        print("busy", flush=True)
        time.sleep(0.5)
        print("undisturbed", flush=True)
        self.endpoints.add_publisher(String, "x", 1)

sys.exit(run(Slow))
"""
SIGNALS = [(SIGINT,), (SIGTERM,), (SIGINT, SIGINT, SIGINT), (SIGTERM, SIGINT), (SIGTERM, SIGTERM)]


def script(folder: Path, text: str, *arguments: str, name: str = "slow_node") -> Process:
    path = folder / f"{name}.py"
    path.write_text(text, encoding="utf-8")
    return Process(folder / f"{name}.log", str(path), *arguments)


@pytest.mark.slow
def test_signals_end_a_node_cleanly_however_many(tmp_path: Path) -> None:
    text = NODE.replace("START", "pass")
    with ExitStack() as stack:
        nodes = [stack.enter_context(script(tmp_path, text, name=f"node{n}")) for n in range(len(SIGNALS))]
        for node in nodes:
            node.wait_for("ready")
        for node, signals in zip(nodes, SIGNALS, strict=True):
            assert node.end(*signals) == 0
            assert node.text.endswith("ready\nshut down\ncode 0\n")


def test_a_signal_while_modules_are_imported_ends_a_node_in_silence(tmp_path: Path) -> None:
    command = ("-m", "sfr_loc_map.nodes.start", "nodes.localisation_node")
    with Process(tmp_path / "node.log", *command) as node:
        wait_until(lambda: handles_signals(node.popen.pid), "the first module")
        assert node.end(SIGTERM) == 0
        assert node.text == ""


@pytest.mark.parametrize(
    ("text", "number", "after"),
    [
        (NODE.replace("START", "print('busy', flush=True); time.sleep(0.5); self.create_publisher"), SIGTERM, ""),
        # no exception in the middle: in a callback from C it would be discarded, and what is half made be used
        (MANAGED, SIGINT, "undisturbed"),
    ],
    ids=["made", "configured"],
)
def test_a_signal_while_the_node_is_being_prepared_ends_it_cleanly(
    tmp_path: Path, text: str, number: int, after: str
) -> None:
    with script(tmp_path, text) as node:
        node.wait_for("busy")
        assert node.end(number) == 0
        assert after in node.text
        assert "Traceback" not in node.text


@pytest.mark.parametrize(
    ("start", "arguments", "code", "words"),
    [
        ("raise NodeError('sought a,\\n found b')", (), 2, "slow_node: sought a, found b\ncode 2\n"),
        ("1 / 0", (), 1, "ZeroDivisionError"),
        ("self.create_timer(0.01, self.fail)", (), 1, "NodeError: after the start"),
        ("pass", ("--ros-args", "--params-file", "/nowhere.yaml"), 2, "slow_node: ROS cannot be initialised"),
    ],
)
def test_errors_of_ours_are_one_line_and_exit_2_and_others_keep_their_traceback(
    tmp_path: Path, start: str, arguments: tuple[str, ...], code: int, words: str
) -> None:
    with script(tmp_path, NODE.replace("START", start), *arguments) as node:
        assert node.popen.wait(60) == code
        assert words in node.text
        assert ("Traceback" in node.text) == (code == 1)
