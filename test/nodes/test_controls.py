import os
import pty
import re
import subprocess
import sys
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfr_loc_map.pipeline.playback.controls import Controls, Pace, Pairs
from sfr_loc_map.pipeline.playback.messages import Message, begin_at


def message(topic: str, stamp_ns: int) -> Message:
    return Message(topic, "", stamp_ns, b"")


class FrameObserver:
    now = 100.0

    def __call__(self) -> float:
        return self.now


def test_messages_are_due_by_their_stamps_each_bench_from_its_own_first() -> None:
    watch, controls = FrameObserver(), Controls(rate=2.0)
    pace = Pace(controls, watch)
    assert pace.wait_s(message("loc/left/image_rect", 5_000_000_000)) == 0
    assert pace.wait_s(message("loc/left/image_rect", 6_000_000_000)) == pytest.approx(0.5)
    watch.now += 0.4
    assert pace.wait_s(message("loc/left/image_rect", 6_000_000_000)) == pytest.approx(0.1)
    assert pace.wait_s(message("nav/left/image_rect", 99)) == 0


def test_after_a_pause_a_step_or_another_rate_the_next_message_is_due_at_once() -> None:
    watch, controls = FrameObserver(), Controls(rate=1.0)
    pace = Pace(controls, watch)
    pace.wait_s(message("loc/x", 0))
    controls.pause()
    pace.wait_s(message("loc/x", 10**10))
    controls.resume()
    assert pace.wait_s(message("loc/x", 10**10)) == 0
    assert pace.wait_s(message("loc/x", 2 * 10**10)) == 10
    controls.rate = 10.0
    assert pace.wait_s(message("loc/x", 2 * 10**10)) == 0
    assert pace.wait_s(message("loc/x", 3 * 10**10)) == 1
    controls.step()
    assert pace.wait_s(message("loc/x", 3 * 10**10)) == 0
    assert not controls.held


def test_keys() -> None:
    controls = Controls(rate=1.0, position_s=7.0)
    controls.key(" ")
    assert controls.held
    controls.key("right")
    controls.key("s")
    assert controls.steps == 2
    controls.key(" ")
    assert (controls.paused, controls.steps) == (False, 0)
    controls.key("left")
    assert controls.jump_s == 2.0
    controls.position_s = 3.0
    controls.key("left")
    assert controls.jump_s == 0.0
    controls.key("f")
    assert controls.jump_s == 8.0
    controls.key("up")
    assert controls.rate == pytest.approx(1.1)
    controls.key("down")
    controls.key("l")
    assert controls.rate == pytest.approx(1.0)
    assert controls.loop
    controls.key("?")
    assert not controls.stopped
    controls.key("q")
    assert controls.stopped
    assert controls.interrupted


def test_a_pair_is_complete_with_both_pictures_and_for_mapping_its_pose() -> None:
    pairs = Pairs()
    assert pairs.add(message("loc/left/camera_info", 1)) is None
    assert pairs.add(message("loc/left/image_rect", 1)) is None
    assert pairs.add(message("loc/right/image_rect", 2)) is None
    assert pairs.add(message("loc/right/image_rect/compressed", 1)) == ("loc", 1)
    for topic in ("nav/pose", "nav/right/image_rect"):
        assert pairs.add(message(topic, 1)) is None
    assert pairs.add(message("nav/left/image_rect", 1)) == ("nav", 1)


@given(st.lists(st.integers(0, 100), min_size=1, max_size=30), st.floats(0, 12))
def test_from_a_place_on_comes_what_is_not_before_it_and_the_first_camera_info(
    tenths: list[int], offset_s: float
) -> None:
    stamps = sorted(10**9 + t * 10**8 for t in tenths)
    whole = [message("loc/left/camera_info", stamps[0])] + [message("loc/left/image_rect", s) for s in stamps]
    told: list[float] = []
    rest = list(begin_at(iter(whole), offset_s, told.append))
    assert rest[0] == whole[0]
    assert rest[1:] == [m for m in whole[1:] if (m.stamp_ns - stamps[0]) * 1e-9 >= offset_s]
    assert all(t >= offset_s for t in told)


def test_keys_of_a_terminal_come_one_by_one_and_the_terminal_is_put_back() -> None:
    code = (
        "import sys, time, termios\nfrom sfr_loc_map.nodes.replay.keyboard import Keyboard\n"
        "before = termios.tcgetattr(0)\nkeys = []\n"
        "with Keyboard() as keyboard:\n    print('there', keyboard.there, flush=True)\n"
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
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            "from sfr_loc_map.nodes.replay.keyboard import Keyboard\nwith Keyboard() as k: print(k.there, k.pressed())",
        ],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == "False []\n"
