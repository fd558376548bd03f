"""Memory and processor time of watched processes, and the publishers that belong to them."""

# ruff: noqa: E402 - ROS may be absent
from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator

import pytest

pytest.importorskip("rclpy")
pytestmark = pytest.mark.ros

from sfr_loc_map.replay.external.process_watch import ProcessWatch, processes_watched

OTHER_VENDOR = (1, 16)  #: Cyclone DDS, whose ids do not contain the process id.


@pytest.fixture
def sleeping() -> Iterator[int]:
    with subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"]) as process:
        yield process.pid
        process.kill()


def publisher(pid: int, vendor: tuple[int, int] = (1, 15)) -> tuple[int, ...]:
    """Return a global id as Fast DDS makes it for a process."""
    return (*vendor, 7, 8, pid & 0xFF, pid >> 8 & 0xFF, *range(10))


def test_a_publisher_belongs_to_the_watched_process_or_to_its_descendant(sleeping: int) -> None:
    above, below = ProcessWatch([os.getpid()]), ProcessWatch([sleeping])
    try:
        assert above.has_publishers([publisher(os.getpid()), publisher(sleeping)])
        assert below.has_publishers([publisher(sleeping)])
        assert not below.has_publishers([publisher(sleeping), publisher(os.getpid())])
        assert below.has_publishers([publisher(os.getpid(), OTHER_VENDOR)])
        assert below.runs_publishers([publisher(sleeping)])
        assert not below.runs_publishers([publisher(sleeping, OTHER_VENDOR)])
        os.kill(sleeping, signal.SIGKILL)
        os.waitid(os.P_PID, sleeping, os.WEXITED | os.WNOWAIT)  # the ended process remains in the table of processes
        assert not below.runs_publishers([publisher(sleeping)])
    finally:
        above.stop()
        below.stop()


def test_the_processes_that_the_replay_started_are_always_watched(sleeping: int) -> None:
    assert set(processes_watched(str(sleeping), [os.getppid()])) == {os.getppid()}  # the other is its descendant
    assert set(processes_watched(str(os.getpid()), [sleeping])) == {os.getpid(), sleeping}


@pytest.mark.parametrize("option", [("--watch", "{text}"), ("--watch={text}",)])
def test_a_replay_is_not_the_process_that_its_command_line_names(option: tuple[str, ...]) -> None:
    text = f"node_of_{os.getpid()}"
    sleep = [sys.executable, "-c", "import time; time.sleep(60)"]
    with (
        subprocess.Popen([*sleep, text]) as node,
        subprocess.Popen([*sleep, *(word.format(text=text) for word in option)]) as replay,
    ):
        try:
            assert processes_watched(text, []) == [node.pid]
        finally:
            node.kill()
            replay.kill()


def test_the_shell_that_starts_a_replay_is_not_the_process_that_the_replay_watches() -> None:
    text = f"node_of_{os.getpid()}"
    module = "sfr_loc_map.replay.external.process_watch"
    watch = f"import sys; from {module} import processes_watched as w; print(w(sys.argv[2], []))"
    words = ["bash", "-c", f"{sys.executable} -c '{watch}' other {text}; true"]
    sleep = [sys.executable, "-c", "import time; time.sleep(60)", text]
    with subprocess.Popen(sleep) as node:
        try:
            assert subprocess.check_output(words, text=True).strip() == f"[{node.pid}]"
        finally:
            node.kill()
