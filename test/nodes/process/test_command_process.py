"""A user's command: started in a group of its own, and nothing of it left."""

from __future__ import annotations

import time
from pathlib import Path

import psutil
import pytest

pytest.importorskip("rclpy")

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.nodes.process.command_process import CommandProcess


def test_how_it_ended_is_told_with_its_last_line(tmp_path: Path) -> None:
    with CommandProcess("sh -c 'echo first; echo \"the reason\" >&2; exit 4'", tmp_path) as process:
        deadline = time.monotonic() + 20
        while not process.ended and time.monotonic() < deadline:
            time.sleep(0.01)
        assert process.ended == "ended with exit code 4: the reason"
        assert process.text == "first\nthe reason\n"


def test_what_it_started_ends_with_it(tmp_path: Path) -> None:
    with CommandProcess("sh -c 'sleep 100 & sleep 100'", tmp_path) as process:
        deadline = time.monotonic() + 20
        while len(children := psutil.Process(process.pid).children()) < 2 and time.monotonic() < deadline:
            time.sleep(0.01)
        assert not process.ended
    psutil.wait_procs(children, timeout=10)
    assert not any(child.is_running() for child in children)


@pytest.mark.parametrize(
    ("command", "words"), [("", "is empty"), ("a 'quote", "No closing quotation"), ("/no/such/program", "cannot start")]
)
def test_a_command_that_cannot_be_is_one_line(tmp_path: Path, command: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words), CommandProcess(command, tmp_path):
        pass
