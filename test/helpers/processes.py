"""Nodes as processes, and a peer that talks to them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import psutil

from helpers import ROOT

PATIENCE_S = 60.0
ASK_AGAIN_S = 3.0


def wait_until(condition: Callable[[], Any], what: str, patience_s: float = PATIENCE_S) -> Any:
    deadline = time.monotonic() + patience_s
    while not (found := condition()):
        assert time.monotonic() < deadline, f"{what} did not happen within {patience_s} s"
        time.sleep(0.02)
    return found


IMPORTS = {"PYTHONPATH": f"{ROOT}{os.pathsep}{ROOT / 'test'}"}
"""Environment of a process that imports the package of this folder and the helpers."""


class Process:
    """A Python process whose output goes to a file; killed at the end of its block if it still runs.

    It imports the package of this folder: the kernels of an installed one are not compiled.
    """

    def __init__(self, log: Path, *command: str, environment: dict[str, str] | None = None) -> None:
        self.log = log
        with log.open("wb") as stream:
            self.popen = subprocess.Popen(
                [sys.executable, *command],
                stdout=stream,
                stderr=subprocess.STDOUT,
                env=os.environ | IMPORTS | (environment or {}),
                start_new_session=True,
            )

    def __enter__(self) -> Process:
        return self

    def __exit__(self, *_: object) -> None:
        self.popen.kill()
        self.popen.wait()

    @property
    def text(self) -> str:
        return self.log.read_text(encoding="utf-8", errors="replace")

    def wait_for(self, words: str) -> None:
        wait_until(lambda: words in self.text or self.popen.poll() is not None, f"'{words}' in {self.log}")
        assert words in self.text, self.text

    def end(self, *signals: signal.Signals, pause_s: float = 0.1) -> int:
        for number in signals:
            if self.popen.poll() is None:
                self.popen.send_signal(number)
            time.sleep(pause_s)
        return self.popen.wait(PATIENCE_S)


def node_process(folder: Path, name: str, *arguments: str) -> Process:
    return Process(folder / f"{name}.log", "-m", "sfr_loc_map.nodes.start", f"nodes.{name}", *arguments)


def nodes_of(pid: int) -> list[int]:
    """Return the processes of our nodes that a process has started."""
    found = []
    for child in psutil.Process(pid).children():
        with suppress(psutil.NoSuchProcess):
            if any("sfr_loc_map.nodes." in word for word in child.cmdline()):
                found.append(child.pid)
    return found


def handles_signals(pid: int) -> bool:
    """Tell whether a process has its own handler of SIGTERM, as nodes have from their first module on."""
    (line,) = [line for line in Path(f"/proc/{pid}/status").read_text().splitlines() if line.startswith("SigCgt:")]
    return bool(int(line.split()[1], 16) >> (signal.SIGTERM - 1) & 1)


def segments_of(pids: list[int]) -> set[Path]:
    """Return the segments of Fast DDS that processes have mapped (its small port files may serve others too)."""
    lines = [line for pid in pids for line in Path(f"/proc/{pid}/maps").read_text().splitlines()]
    return {Path(line.split()[-1]) for line in lines if "/dev/shm/fastrtps_" in line and "_port" not in line}


def has_started_ros(pid: int) -> bool:
    """Tell whether ROS has started in a process: it has its segment of Fast DDS, and the handlers of signals."""
    return bool(segments_of([pid]))


class Peer:
    """A node in the test's process."""

    def __init__(self) -> None:
        import rclpy
        from rclpy.executors import SingleThreadedExecutor

        self.node = rclpy.create_node("peer")
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.qos: Any = 50
        """Of publishers."""
        self._publishers: dict[str, Any] = {}
        self._watched: list[Process] = []

    def __enter__(self) -> Peer:
        return self

    def __exit__(self, *_: object) -> None:
        self.node.destroy_node()

    def listen(self, kind: type[Any], topic: str, *, latched: bool = False) -> list[Any]:
        from rclpy.qos import DurabilityPolicy, QoSProfile

        qos, taken = QoSProfile(depth=100), list[Any]()
        if latched:
            qos.durability = DurabilityPolicy.TRANSIENT_LOCAL
        self.node.create_subscription(kind, topic, taken.append, qos)
        return taken

    def publish(self, kind: type[Any], topic: str, message: Any, *, arrival: bool = False) -> None:
        """Publish a message or its serialised form, once somebody listens.

        Messages on different topics have no order of their own: with `arrival` this one is waited for.
        """
        from rclpy.duration import Duration

        if topic not in self._publishers:
            self._publishers[topic] = self.node.create_publisher(kind, topic, self.qos)
        publisher = self._publishers[topic]
        self.until(lambda: publisher.get_subscription_count() > 0, f"a listener on {topic}")
        publisher.publish(message)
        if arrival:
            publisher.wait_for_all_acked(Duration(seconds=5))

    def call(self, service: str) -> Any:
        from std_srvs.srv import Trigger

        client = self.node.create_client(Trigger, service)
        return self.answer(client, Trigger.Request(), again=False)

    def answer(self, client: Any, request: Any, *, again: bool) -> Any:
        """Return the answer of a service; ask again where none comes, as of a node that has not found its asker yet."""
        self.until(client.service_is_ready, f"service {client.srv_name}")
        futures = [client.call_async(request)]
        asked = time.monotonic()

        def answered() -> Any:
            if again and time.monotonic() - asked > ASK_AGAIN_S * len(futures):
                futures.append(client.call_async(request))
            return next((future for future in futures if future.done()), None)

        return self.until(answered, f"answer of {client.srv_name}").result()

    def wait_until_known_to(self, node: str) -> None:
        """Wait until a node knows all readers of this one, so that nothing it publishes is missed.

        They are announced in the order in which they were made; that of the answer's reader is the last.
        """
        from rcl_interfaces.srv import ListParameters

        client = self.node.create_client(ListParameters, f"{node}/list_parameters")
        self.answer(client, ListParameters.Request(), again=True)

    def until(self, condition: Callable[[], Any], what: str, patience_s: float = PATIENCE_S) -> Any:
        deadline = time.monotonic() + patience_s
        while not (found := condition()):
            said = "".join(f"\n{process.text}" for process in self._watched)
            assert time.monotonic() < deadline, f"{what} did not come within {patience_s} s{said}"
            self.executor.spin_once(timeout_sec=0.05)
        return found

    def watch(self, process: Process) -> None:
        """Say what a process wrote where something is awaited in vain."""
        self._watched.append(process)

    def spin(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.02)
