"""The terminal shows the strings of the tables at 80 columns, without colour, and ends as a terminal program should."""

from __future__ import annotations

import fcntl
import io
import os
import pty
import re
import signal
import struct
import sys
import termios
from contextlib import suppress
from typing import Any

import pytest
from rich.console import Console

from helpers.live_run import NODES, health, pose_pair, report, updates
from sfr_loc_map.live.run_end import RunEnd
from sfr_loc_map.live.state import LiveState
from sfr_loc_map.live.terminal import Terminal, one_line_of
from sfr_loc_map.live.updates import PublishedScore
from sfr_loc_map.message_types import Level
from sfr_loc_map.report.score_tables import score_tables
from sfr_loc_map.signals import handle_signals

BEGIN_S, COUNT = 1_700_000_000.0, 200
END_S = BEGIN_S + 0.1 * COUNT


@pytest.fixture(scope="module")
def recorded() -> list[Any]:
    return list(updates(COUNT, BEGIN_S))


def drawn(
    records: list[Any], now_s: float, width: int = 80, height: int = 50, aborted: str = "", ended: bool = False
) -> str:
    state, text = LiveState(), io.StringIO()
    console = Console(file=text, width=width, height=height, highlight=False, force_terminal=True, color_system=None)
    for record in records:
        state.put(record)
    if aborted or ended:
        state.end(RunEnd(aborted=aborted), now_s)
    console.print(Terminal(state, "rover1", console).drawing(now_s), end="")
    return text.getvalue()


def test_every_figure_is_shown_as_the_tables_have_it(recorded: list[Any]) -> None:
    text = drawn(recorded, END_S + 0.1)
    assert max(map(len, text.splitlines())) <= 80
    state = LiveState()
    for record in recorded:
        state.put(record)
    assert state.score is not None
    tables = {table.name: table for table in score_tables(state.score.score)}
    words, one = " ".join(text.split()), one_line_of(state, END_S)
    for row in tables["headline"].rows:
        assert all(part in words for cell in row[2:8] for part in cell.text.split()), row
        assert all(cell.text in one for cell in row[2:8])
    for bar in state.score.bars:
        assert all(part in words for text in (bar.state, bar.value, bar.margin) for part in text.split())
    for expected in ("pose 200: tracking", "35.1 ms", "3 in transport", "2 of localisation/odometry"):
        assert expected in words, words
    assert state.score.overall.text in words
    assert "\n" not in one


@pytest.mark.parametrize(("width", "height"), [(60, 15), (80, 24)])
def test_small_terminals_show_verdict_state_nodes_and_the_worst_limit(
    recorded: list[Any], width: int, height: int
) -> None:
    text = drawn(recorded, END_S + 0.1, width, height)
    assert len(text.splitlines()) <= height
    words = " ".join(text.split())
    for expected in ("of 4 limits met", "pose 200: tracking", "localisation ✔ ok", "monitor ✔ ok", "margin", " mm"):
        assert expected in words, text
    ended = " ".join(drawn(recorded, END_S + 0.1, width, height, "monitor_node was killed by SIGKILL").split())
    assert "■ aborted" in ended
    assert "monitor_node was killed by SIGKILL at" in ended
    assert "ended at " in drawn(recorded, END_S + 0.1, width, height, ended=True)


def test_what_is_stale_lost_or_hostile_is_said_in_words(recorded: list[Any]) -> None:
    assert "○" not in drawn(recorded, END_S + 0.5)
    later = drawn(recorded, END_S + 7.0)
    assert re.search(r"○ [\w ]+, 7 s old  no pose for 7.1 s", later)
    assert len(re.findall(r"\? stale", later)) == 3
    silent = [*recorded, *(health(node, END_S + 7.0) for node in NODES)]
    silent.append(health("localisation_node", END_S + 7.0, Level.ERROR, "lost: no_features"))
    silent += [pose_pair(COUNT + 20, END_S + 7.0, lost=True)[1], report(COUNT, END_S + 7.0)]
    back = drawn(silent, END_S + 7.1)
    assert "○" not in back
    assert "pose 201: lost" in back
    assert "localisation_node: lost: no_features" in back
    hostile = PublishedScore(
        '{"schema": "sfr-score/2", "verdicts": [], "warnings": ["[red]\\u001b]0;own\\u0007[/] x"]}', END_S
    )
    text = drawn([hostile], END_S)
    assert not re.search(r"\x1b\]0|\x07", text)


def on_terminal(end: Any) -> tuple[str, int]:
    """Return what the program writes on a terminal of its own, and its exit code."""
    pid, terminal = pty.fork()
    if pid == 0:
        for name in ("COLUMNS", "LINES"):  # which processes of pytest-xdist have
            os.environ.pop(name, None)
        sys.stdin, sys.stdout = os.fdopen(0), os.fdopen(1, "w")  # of this process, not those of the tests
        handle_signals()
        try:
            Terminal(LiveState(), "rover1", Console(highlight=False, force_terminal=True)).show()
        except KeyboardInterrupt:
            os._exit(130)
        os._exit(0)
    fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
    text = b""
    while b"q: quit" not in text:
        text += os.read(terminal, 4000)
    end(pid, terminal)
    with suppress(OSError):  # once the program has ended
        while True:
            text += os.read(terminal, 4000)
    return text.decode(), os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


@pytest.mark.parametrize(
    ("end", "expected"),
    [
        (lambda _, terminal: os.write(terminal, b"q"), 0),
        (lambda pid, _: os.kill(pid, signal.SIGHUP), 130),  # which does what SIGINT does
    ],
)
def test_q_and_signals_end_it_and_the_terminal_is_restored(end: Any, expected: int) -> None:
    text, code = on_terminal(end)
    assert code == expected
    assert text.count("\x1b[?1049h") == text.count("\x1b[?1049l") == 1
