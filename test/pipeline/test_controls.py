"""Keys of a terminal."""

from __future__ import annotations

import os
import pty
import re
import subprocess
import sys
import time


def test_keys_of_a_terminal_come_one_by_one_and_the_terminal_is_restored() -> None:
    code = (
        "import sys, time, termios\nfrom sfr_loc_map.pipeline.controls import Keyboard\n"
        "before = termios.tcgetattr(0)\nkeys = []\n"
        "with Keyboard() as keyboard:\n    print('there', keyboard.is_there, flush=True)\n"
        "    while 'q' not in keys:\n        keys += keyboard.pressed(); time.sleep(0.01)\n"
        "print(keys, termios.tcgetattr(0) == before, flush=True)\n"
    )
    pid, terminal = pty.fork()
    if pid == 0:
        os.execv(sys.executable, [sys.executable, "-c", code])
    text = b""
    while b"there" not in text:
        text += os.read(terminal, 1000)
    time.sleep(0.1)
    os.write(terminal, b" s\x1b[C\x1b[Aq")
    while not re.search(rb"\] (True|False)", text):
        text += os.read(terminal, 1000)
    os.waitpid(pid, 0)
    assert b"there True" in text
    assert b"[' ', 's', 'right', 'up', 'q'] True" in text


def test_a_terminal_that_is_not_the_controlling_one_has_no_keys() -> None:
    """As with `setsid`, in containers and under some schedulers: to ask for its foreground group is an error."""
    code = "from sfr_loc_map.pipeline.controls import Keyboard\nwith Keyboard() as k: print(k.is_there, k.pressed())"
    ours, theirs = pty.openpty()
    try:
        done = subprocess.run(
            [sys.executable, "-c", code],
            stdin=theirs,
            capture_output=True,
            text=True,
            start_new_session=True,
            check=False,
        )
    finally:
        os.close(ours)
        os.close(theirs)
    assert (done.returncode, done.stdout) == (0, "False []\n"), done.stderr
