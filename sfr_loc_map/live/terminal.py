"""Display a run in progress on a terminal of 80 columns, for example over ssh.

Without a terminal, one line is printed per second. Numbers have the same format as in the tables of a score. Verdicts
and levels are given by a word and a sign, so that no colour is required.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from typing import Any

from rich.console import Console, Group, RenderableType
from rich.layout import Layout
from rich.live import Live
from rich.table import Column
from rich.table import Table as Grid
from rich.text import Text

from sfr_loc_map.live.headline import clock_time
from sfr_loc_map.live.keyboard import Keyboard
from sfr_loc_map.live.state import LiveState
from sfr_loc_map.live.values import live_values, score_values
from sfr_loc_map.message_text import one_line, printable
from sfr_loc_map.message_types import Level
from sfr_loc_map.report.verdict_view import OPEN, style_of
from sfr_loc_map.report.verdict_view import STYLES as VERDICT_STYLES
from sfr_loc_map.tables.model import ABSENT, METRE, MIB, MILLISECOND, fitting, number

PERIOD_S = 0.5  #: Period of the screen.
LINE_PERIOD_S = 1.0  #: Period of the lines without a terminal.
KEY_PERIOD_S = 0.05  #: Period of the check for keys.
STYLES = {
    Level.OK: ("✔", "green"),
    Level.WARN: ("!", "yellow"),
    Level.ERROR: ("✖", "bold red"),
    Level.STALE: ("?", "bold yellow"),
}
"""Sign and style of each level."""
LEVELS = {level.word: style for level, style in STYLES.items()}
COLOURS = {style.css: style.colour for style in (*VERDICT_STYLES.values(), OPEN)} | {"stale": "bold yellow"}
"""Colour of each style of a headline."""
WIDE = 80  #: Minimum width for all figures of a node, columns.


class Terminal:
    """Displays a state until q is pressed."""

    def __init__(self, state: LiveState, title: str, console: Console | None = None) -> None:
        self._state, self._title = state, title
        self._console = console or Console(highlight=False)
        self._ended = False

    def show(self) -> None:
        """Display the state until q is pressed, then restore the terminal; a signal raises a KeyboardInterrupt."""
        console, due_s = self._console, 0.0
        with suppress(AttributeError, ValueError):  # signs that the encoding of the terminal lacks are replaced
            console.file.reconfigure(errors="replace")  # type: ignore[attr-defined]
        with ExitStack() as stack:
            keyboard, screen = None, None
            if console.is_terminal:
                keyboard = stack.enter_context(Keyboard())
                screen = stack.enter_context(Live(console=console, screen=True, auto_refresh=False))
            while not self._ended:
                for key in keyboard.pressed() if keyboard is not None else "":
                    self._press(key)
                    due_s = 0.0
                if time.monotonic() >= due_s:
                    self._state.tick(time.time())
                    if screen is not None:
                        screen.update(self.drawing(time.time()), refresh=True)
                    else:
                        self._print_line()
                    due_s = time.monotonic() + (PERIOD_S if screen is not None else LINE_PERIOD_S)
                time.sleep(KEY_PERIOD_S)
        if console.is_terminal:
            self._print_line()

    def drawing(self, now_s: float) -> RenderableType:
        """Return the content of the screen, the most important parts first."""
        with self._state.lock:
            live, score = live_values(self._state, now_s), score_values(self._state)
        body = Group(*_parts(live, score, now_s, self._title, self._console.width))
        layout = Layout()
        foot = Text("q: quit", "reverse", no_wrap=True, overflow="ellipsis")
        layout.split_column(Layout(body), Layout(foot, size=1))
        return layout

    def _print_line(self) -> None:
        self._console.print(Text(one_line_of(self._state, time.time())), soft_wrap=True)
        self._console.file.flush()

    def _press(self, key: str) -> None:
        if key in ("q", "Q"):
            self._ended = True


def one_line_of(state: LiveState, now_s: float) -> str:
    """Return one line with the verdict and its age or end, headline figures, state and nodes."""
    with state.lock:
        live, score = live_values(state, now_s), score_values(state)
    shown = live["headline"]
    parts = [clock_time(now_s), f"{_word(shown)}: {shown['text'].rstrip('.')}"]
    for columns, rows in _figures(score):
        headings = [column["heading"] for column in columns if not column["words"]]
        for title, unit, *numbers in rows:
            known = [f"{heading} {text}" for heading, text in zip(headings, numbers, strict=True) if text != ABSENT]
            parts.append(f"{title}, {unit} {' '.join(known)}")
    parts += _now(live)
    for node in live["nodes"]:
        parts.append(" ".join((node["name"], node["level"], *_costs(node, live))))
    return printable(" ".join("; ".join(parts).split()))


def _parts(
    live: dict[str, Any], score: dict[str, Any], now_s: float, title: str, width: int
) -> Iterator[RenderableType]:
    head = Grid.grid(Column(ratio=1, no_wrap=True), Column(justify="right", no_wrap=True), expand=True)
    head.add_row(Text(f"sfr live  {one_line(title)}", "bold"), clock_time(now_s))
    yield head
    shown = live["headline"]
    yield Text.assemble((f" {_word(shown)} ", f"reverse {COLOURS[shown['style']]}"), f" {one_line(shown['text'])}")
    yield from map(Text, _now(live))
    if live["nodes"]:
        wide = width >= WIDE
        names = ("node", "health", "state", "call", *(("memory", "dropped") if wide else ()), "heard")
        nodes = Grid(*names, box=None, pad_edge=False, padding=(0, 1, 0, 0), header_style="bold")
        for node in live["nodes"]:
            words = _node_words(node, live)
            nodes.add_row(*(words if wide else (*words[:4], words[-1])))
        yield nodes
    if score["limits"]:
        limits = Grid("verdict", "of", box=None, pad_edge=False, padding=(0, 1, 0, 0))
        for name in ("value", "limit", "margin"):
            limits.add_column(name, justify="right", no_wrap=True)
        for bar in score["limits"]:
            verdict = Text(f"{bar['icon']} {bar['state']}", style_of(bar["state"]).colour)
            limits.add_row(verdict, bar["name"], bar["value"], bar["limit"], bar["margin"])
        yield limits
    yield from map(Text, _notes(live, score))
    for columns, rows in _figures(score):
        grid = Grid(box=None, pad_edge=False, padding=(0, 1, 0, 0), header_style="bold")
        for column in columns:
            grid.add_column(Text(column["heading"]), justify="left" if column["words"] else "right", overflow="fold")
        for row in rows:
            grid.add_row(*map(Text, row))
        yield grid


def _word(shown: dict[str, str]) -> str:
    return ", ".join(filter(None, (f"{shown['icon']} {shown['word']}", shown["age"])))


def _figures(score: dict[str, Any]) -> Iterator[tuple[list[dict[str, Any]], list[list[str]]]]:
    """Yield the columns and the rows of the table of headline figures: name and unit, then numbers."""
    for table in score["tables"]:
        if table["name"] == "headline":
            yield table["columns"], [[cell.get("text", "") for cell in row] for row in table["rows"]]


def _node_words(node: dict[str, Any], live: dict[str, Any]) -> list[Text | str]:
    icon, style = LEVELS[node["level"]]
    health = Text(f"{icon} {node['level']}", style)
    if node["lifecycle"] not in ("active", "unknown"):
        health.append(f", {one_line(node['lifecycle'])}")
    heard = "never" if node["age_s"] is None else f"{node['age_s']:.1f} s"
    name = one_line(node["name"]).removesuffix("_node")
    return [name, health, _state_text(node), *_costs(node, live), str(sum(node["drops"].values())), heard]


def _state_text(found: dict[str, Any]) -> str:
    return one_line(": ".join(filter(None, (found["state"], found["reason"]))))


def _costs(node: dict[str, Any], live: dict[str, Any]) -> tuple[str, str]:
    call = live["last_call"].get(node["name"], {})
    took, memory = call.get("processing_time_s"), call.get("memory_bytes")
    return (
        ABSENT if took is None else f"{number(took, unit=MILLISECOND)} ms",
        ABSENT if memory is None else f"{number(memory, unit=MIB)} MiB",
    )


def _now(live: dict[str, Any]) -> Iterator[str]:
    """Yield the pose and its error."""
    if (row := live["localisation"]) is not None:
        word = _state_text(row) or "state unknown"
        place = " ".join(f"{value:z.2f}" for value in row["position_m"])
        yield f"pose {row['n'] + 1}: {word}, at {place} m, {number(row['distance_m'], unit=METRE)} m travelled"
        if (error := row["error_m"]) is not None:
            unit = fitting(METRE, *error)
            yield f"error x y z: {' '.join(number(value, unit=unit, signed=True) for value in error)} {unit.symbol}"


def _notes(live: dict[str, Any], score: dict[str, Any]) -> Iterator[str]:
    """Yield problems of nodes, dropped and lost messages, warnings of the score, and the last unreadable input."""
    for node in live["nodes"]:
        name = one_line(node["name"])
        if node["level"] in (Level.WARN.word, Level.ERROR.word):
            yield f"{name}: {one_line(node['message'])}"
        if drops := [f"{count} {cause}" for cause, count in node["drops"].items() if count]:
            yield f"{name} dropped: {', '.join(drops)}"
    if lost := [f"{topic['lost']} of {name}" for name, topic in live["topics"].items() if topic["lost"]]:
        yield "lost in transport to this view: " + ", ".join(lost)
    yield from (f"warning: {one_line(text)}" for text in score["warnings"])
    if live["problems"]:
        yield f"unreadable input: {live['problems'][-1]}"
