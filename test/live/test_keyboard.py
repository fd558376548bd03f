"""Single keys of a terminal."""

from __future__ import annotations

import os
import pty
import re
import sys

READ = """
import sys, time, termios
from sfr_loc_map.live.keyboard import Keyboard
before, keys = termios.tcgetattr(0), ""
with Keyboard() as keyboard:
    print("there", keyboard.is_there, keyboard.pressed(), flush=True)
    while keyboard.is_there and "q" not in keys:
        keys += keyboard.pressed()
        time.sleep(0.01)
print([keys], termios.tcgetattr(0) == before, flush=True)
"""


def test_keys_of_a_terminal_come_one_by_one_and_the_terminal_is_restored() -> None:
    pid, terminal = pty.fork()
    if pid == 0:
        os.execv(sys.executable, [sys.executable, "-c", READ])
    text = b""
    while not re.search(rb"\] (True|False)", text):
        text += os.read(terminal, 1000)
        if text.endswith(b"there True \r\n"):
            os.write(terminal, b" sq")
    os.waitpid(pid, 0)
    assert b"[' sq'] True" in text
