"""Keys of a terminal, and what they do."""

from __future__ import annotations

import os
import pty
import re
import sys

import pytest

from sfr_loc_map.pipeline.controls import Controls

READ = """
import sys, time, termios
from sfr_loc_map.pipeline.controls import Keyboard
before, keys = termios.tcgetattr(0), []
with Keyboard() as keyboard:
    print("there", keyboard.is_there, keyboard.pressed(), flush=True)
    while keyboard.is_there and "q" not in keys:
        keys += keyboard.pressed()
        time.sleep(0.01)
print(keys, termios.tcgetattr(0) == before, flush=True)
"""


def test_keys_of_a_terminal_come_one_by_one_and_the_terminal_is_restored() -> None:
    pid, terminal = pty.fork()
    if pid == 0:
        os.execv(sys.executable, [sys.executable, "-c", READ])
    text = b""
    while not re.search(rb"\] (True|False)", text):
        text += os.read(terminal, 1000)
        if text.endswith(b"there True []\r\n"):
            os.write(terminal, b" s\x1b[C\x1b[Aq")
    os.waitpid(pid, 0)
    assert b"[' ', 's', 'right', 'up', 'q'] True" in text


def test_what_keys_do() -> None:
    controls = Controls(rate=1.0, position_s=7.0, end_s=12.0)
    for key, name, expected in (
        (" ", "held", True),
        ("right", "steps", 1),
        ("s", "steps", 2),
        (" ", "paused", False),
        ("left", "seek_s", 2.0),
        ("f", "seek_s", 12.0),
        ("up", "rate", 1.1),
        ("down", "rate", 1.0),
        ("l", "loop", True),
        ("?", "stopped", False),
    ):
        controls.key(key)
        assert getattr(controls, name) == pytest.approx(expected), key
    controls.position_s = 9.0
    controls.key("f")  # beyond the last pair: no effect
    assert controls.next_start_s() == 12.0
    controls.key("q")
    assert (controls.interrupted, controls.next_start_s()) == (True, None)
