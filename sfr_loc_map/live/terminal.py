"""A run shown on a terminal while it goes on, for a shell far away, 80 columns wide; lines, where there is no terminal.

The strings are those of the tables. A verdict and a level are told by a word and a sign; colour only repeats them.
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

from sfr_loc_map.inputs import one_line, printable
from sfr_loc_map.live.state import LiveState
from sfr_loc_map.live.updates import LOCALISATION, REPORT, Action, Command
from sfr_loc_map.pipeline.controls import SEEK_STEP_S, Keyboard
from sfr_loc_map.report.tables import ABSENT, METRE, MIB, MILLISECOND, OPEN, VERDICTS, number, to_rich

PERIOD_S, LINE_PERIOD_S, KEY_PERIOD_S = 0.5, 1.0, 0.05
"""Time between two drawings of the screen, two lines, two looks at the keys."""
LEVELS = {"ok": ("✔", "green"), "warning": ("!", "yellow"), "error": ("✖", "bold red"), "stale": ("?", "bold yellow")}
WAITING = "no figures yet: waiting for metrics/report of the monitor"


class Terminal:
    """Draws a state until q is pressed. Of a player, space pauses and the arrows go back and on."""

    def __init__(self, state: LiveState, title: str, console: Console | None = None) -> None:
        """Draw nothing yet; without a console standard output is drawn on."""
        self._state, self._title = state, title
        self._console = console or Console(highlight=False)
        self._ended = False

    def show(self) -> None:
        """Draw until q is pressed; KeyboardInterrupt by a signal. The terminal is then as it was before."""
        console, due_s = self._console, 0.0
        with suppress(AttributeError, ValueError):  # a terminal without these signs
            console.file.reconfigure(errors="replace")  # type: ignore[attr-defined]
        with ExitStack() as stack:
            keyboard, screen = None, None
            if console.is_terminal:
                keyboard = stack.enter_context(Keyboard())
                screen = stack.enter_context(Live(console=console, screen=True, auto_refresh=False))
            while not self._ended:
                for key in keyboard.pressed() if keyboard is not None else ():
                    self._press(key)
                    due_s = 0.0
                if time.monotonic() >= due_s:
                    if screen is not None:
                        screen.update(self.drawing(time.time()), refresh=True)
                    else:
                        self._print_line()
                    due_s = time.monotonic() + (PERIOD_S if screen is not None else LINE_PERIOD_S)
                time.sleep(KEY_PERIOD_S)
        if console.is_terminal:
            self._print_line()

    def drawing(self, now_s: float) -> RenderableType:
        """Return the whole screen, the most important first."""
        with self._state.lock:
            live = self._state.live_to_plain(now_s)
            body = Group(*_parts(self._state, live, now_s, self._title))
        words = "q ends"
        if (line := live["time_line"]) is not None:
            state = "playing" if line["playing"] else "at its end" if line["at_s"] >= line["end_s"] else "paused"
            words = f"{line['at_s']:.1f} of {line['end_s']:.1f} s, {state}   q ends, space pauses, left and right 5 s"
        layout = Layout()
        foot = Text(words, "reverse", no_wrap=True, overflow="ellipsis")
        layout.split_column(Layout(body), Layout(foot, size=1))
        return layout

    def _print_line(self) -> None:
        self._console.print(Text(one_line_of(self._state, time.time())), soft_wrap=True)
        self._console.file.flush()

    def _press(self, key: str) -> None:
        place = self._state.time_line
        if key in ("q", "Q"):
            self._ended = True
        elif place is not None and key == " ":
            self._state.run(Command(Action.PAUSE if place.playing else Action.PLAY))
        elif place is not None and key in ("left", "right"):
            step = SEEK_STEP_S if key == "right" else -SEEK_STEP_S
            self._state.run(Command(Action.SEEK, at_s=min(max(place.at_s + step, 0.0), place.end_s)))


def one_line_of(state: LiveState, now_s: float) -> str:
    """Return what is shown in one line: verdict, headline figures, state, nodes, what is stale."""
    with state.lock:
        live, report = state.live_to_plain(now_s), state.report
        parts = [_clock(now_s), *(f"STALE: {words}" for words in _stale(live))]
        parts.append(WAITING if report is None else f"{report.overall.state}: {report.overall.text.rstrip('.')}")
        headline = next((table for table in report.tables if table.name == "headline"), None) if report else None
        for row in headline.rows if headline else ():
            mean, sigma, name, bound, interval, count = (cell.text for cell in row[2:8])
            parts.append(
                f"{row[0].text}, {row[1].text} mean {mean} sigma {sigma} {name} {bound} ({interval}, n {count})"
            )
    parts += _now(live)
    for node in live["nodes"]:
        parts.append(" ".join((node["name"], node["level"], *_costs(node, live))))
    return printable(" ".join("; ".join(parts).split()))


def _parts(state: LiveState, live: dict[str, Any], now_s: float, title: str) -> Iterator[RenderableType]:
    head = Grid.grid(Column(ratio=1, no_wrap=True), Column(justify="right", no_wrap=True), expand=True)
    stale = ", ".join(_stale(live))
    right = Text.assemble((f" STALE: {stale} ", "reverse bold yellow"), " ") if stale else Text()
    head.add_row(Text(f"sfr live  {one_line(title)}", "bold"), right + Text(_clock(now_s)))
    yield head
    if state.report is None:
        yield Text(f" {WAITING}", "italic")
    else:
        overall = state.report.overall
        style = VERDICTS.get(overall.state, OPEN).colour
        yield Text.assemble((f" {overall.icon} {overall.state} ", f"reverse {style}"), f" {overall.text}")
    yield from _tables(state, "headline")
    yield from map(Text, _now(live))
    if live["nodes"]:
        names = ("node", "health", "state", "call", "memory", "dropped", "heard")
        nodes = Grid(*names, box=None, pad_edge=False, padding=(0, 1, 0, 0), header_style="bold")
        for node in live["nodes"]:
            nodes.add_row(*_node_words(node, live))
        yield nodes
    yield from _tables(state, "verdicts")
    yield from map(Text, _notes(state, live))


def _tables(state: LiveState, name: str) -> Iterator[Grid]:
    for table in () if state.report is None else state.report.tables:
        if table.name == name:
            grid = to_rich(table)
            grid.title = grid.caption = grid.box = None
            grid.padding = (0, 1, 0, 0)
            yield grid


def _node_words(node: dict[str, Any], live: dict[str, Any]) -> list[Text | str]:
    icon, style = LEVELS[node["level"]]
    health = Text(f"{icon} {node['level']}", style)
    if node["lifecycle"] not in ("active", "unknown"):
        health.append(f", {one_line(node['lifecycle'])}")
    heard = "never" if node["age_s"] is None else f"{node['age_s']:.1f} s"
    dropped = str(sum(_drops(node).values()))
    return [one_line(node["name"]), health, one_line(node["state"]), *_costs(node, live), dropped, heard]


def _costs(node: dict[str, Any], live: dict[str, Any]) -> tuple[str, str]:
    """Return time and memory of the last call of a node."""
    call = live["last_call"].get(node["name"], {})
    took, memory = call.get("processing_time_s"), call.get("memory_bytes")
    return (
        ABSENT if took is None else f"{number(took, unit=MILLISECOND)} ms",
        ABSENT if memory is None else f"{number(memory, unit=MIB)} MiB",
    )


def _stale(live: dict[str, Any]) -> list[str]:
    """Say what is not of this moment any more."""
    topics = ((words, live["topics"].get(name)) for name, words in ((LOCALISATION, "pose"), (REPORT, "figures")))
    return [f"no {words} for {topic['age_s']:.1f} s" for words, topic in topics if topic is not None and topic["stale"]]


def _now(live: dict[str, Any]) -> Iterator[str]:
    """Say where the rover is and how the sub-trajectory under way stands."""
    if (row := live["localisation"]) is not None:
        word = "lost" if row["lost"] else one_line(row["state"]) or "state unknown"
        place = " ".join(f"{value:.3f}" for value in row["position_m"])
        yield f"pose {row['n'] + 1}: {word}, at {place} m, {number(row['distance_m'], unit=METRE)} m driven"
        if row["error_m"] is not None:
            yield f"error x y z: {' '.join(number(value, signed=True) for value in row['error_m'])} m"
    if (found := live["under_way"]) is not None:
        size = number(sum(value * value for value in found["error"]) ** 0.5)
        yield f"under way: {found['condition']}, {found['progress']:.0%}, error {size} m"


def _notes(state: LiveState, live: dict[str, Any]) -> Iterator[str]:
    """Say what is wrong with nodes, what was dropped and why, what could not be read."""
    for node in live["nodes"]:
        name = one_line(node["name"])
        if node["level"] in ("warning", "error"):
            yield f"{name}: {one_line(node['message'])}"
        if drops := [f"{count} {cause}" for cause, count in _drops(node).items() if count]:
            yield f"{name} dropped: {', '.join(drops)}"
    if lost := [f"{count} of {topic}" for topic, count in state.lost.items() if count]:
        yield "not received here: " + ", ".join(lost)
    if state.report is not None:
        yield from (f"warning: {one_line(text)}" for text in state.report.score.warnings)
    if state.problems:
        yield f"not readable: {state.problems[-1]}"


def _drops(node: dict[str, Any]) -> dict[str, int]:
    """Return how much a node has dropped, by cause."""
    dropped = [(name, text) for name, text in node["values"].items() if name.startswith("dropped_")]
    return {name.removeprefix("dropped_").replace("_", " "): int(text) for name, text in dropped if text.isdecimal()}


def _clock(now_s: float) -> str:
    return time.strftime("%H:%M:%S", time.localtime(now_s))
