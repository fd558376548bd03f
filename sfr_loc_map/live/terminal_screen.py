"""The state of a run as it stands on a terminal: the strings of the tables, 80 columns wide.

A verdict and a level are told by a word and a sign; colour only repeats them.
"""

from __future__ import annotations

import time
from collections.abc import Iterator

from rich.console import Console, ConsoleOptions, Group, RenderableType, RenderResult
from rich.table import Table as Grid
from rich.text import Text

from sfr_loc_map.inputs import one_line, printable
from sfr_loc_map.live.node_view import CallSample, NodeView
from sfr_loc_map.live.state import LOCALISATION, REPORT, LiveState
from sfr_loc_map.report.tables import (
    ABSENT,
    METRE,
    MIB,
    MILLISECOND,
    OPEN,
    VERDICTS,
    Row,
    Table,
    number,
)

LEVELS = {"ok": ("✔", "green"), "warning": ("!", "yellow"), "error": ("✖", "bold red"), "stale": ("?", "bold yellow")}
"""Sign and colour of the level of a node."""
DROPPED, LATENCY, P95 = "dropped_", "latency_", "_p95_s"
FIGURE_WIDTH, NUMBER_WIDTH, VERDICT_WIDTH = 18, 10, 17
WAITING = "no figures yet: waiting for metrics/report of the monitor"


def screen(state: LiveState, now_s: float, title: str) -> RenderableType:
    """Return all that is shown, the most important first: what finds no room on the screen is at the end."""
    parts: list[RenderableType] = [_head(state, now_s, title), _banner(state)]
    now_s = state.moment(now_s)
    named = {} if state.report is None else {table.name: table for table in state.report.tables}
    if "headline" in named:
        parts.append(_figures(named["headline"]))
    parts += [Text(words) for words in _now(state)]
    if state.nodes:
        parts.append(_nodes(state, now_s))
    if "verdicts" in named:
        parts.append(_verdicts(named["verdicts"]))
    parts += [Text(words) for words in _notes(state)]
    return Group(*parts)


def line(state: LiveState, now_s: float) -> str:
    """Return the same in one line: verdict, state, headline figures, nodes, what is stale."""
    parts = [clock(now_s), *(f"STALE: {words}" for words in _stale(state, now_s))]
    now_s = state.moment(now_s)
    report = state.report
    if report is None:
        parts.append(WAITING)
    else:
        parts.append(f"{report.overall.state}: {report.overall.text.rstrip('.')}")
        parts += [_figure_words(row) for table in report.tables if table.name == "headline" for row in table.rows]
    parts += _now(state)
    calls = {call.node: call for call in state.calls}
    for name in sorted(state.nodes):
        took = calls.get(name)
        words = [name, _level(state.nodes[name], now_s), *(_call_words(took) if took is not None else ())]
        parts.append(" ".join(words))
    return printable(" ".join("; ".join(parts).split()))


def clock(now_s: float) -> str:
    """Return the time of day."""
    return time.strftime("%H:%M:%S", time.localtime(now_s))


def _head(state: LiveState, now_s: float, title: str) -> RenderableType:
    grid = Grid.grid(expand=True)
    grid.add_column(ratio=1, no_wrap=True, overflow="ellipsis")
    grid.add_column(justify="right", no_wrap=True)
    stale = ", ".join(_stale(state, now_s))
    right = Text.assemble((f" STALE: {stale} ", "reverse bold yellow"), " ") if stale else Text()
    grid.add_row(Text(f"sfr live  {one_line(title)}", "bold"), right + Text(clock(now_s)))
    return grid


def _stale(state: LiveState, now_s: float) -> Iterator[str]:
    """Say what is not of this moment any more."""
    now_s = state.moment(now_s)
    for name, words in ((LOCALISATION, "pose"), (REPORT, "figures")):
        topic = state.topics.get(name)
        if topic is not None and topic.is_stale(now_s):
            yield f"no {words} for {_age(now_s - topic.received_s)}"


def _banner(state: LiveState) -> Text:
    if state.report is None:
        return Text(f" {WAITING}", "italic")
    overall = state.report.overall
    style = VERDICTS.get(overall.state, OPEN).colour
    return Text.assemble((f" {overall.icon} {overall.state} ", f"reverse {style}"), f" {overall.text}")


def _figures(table: Table) -> RenderableType:
    """Return figure, mean, sigma, mean + 3 sigma, interval, n, with the unit behind the figure."""
    grid = _grid("figure", FIGURE_WIDTH)
    for column in table.columns[2:5]:
        grid.add_column(column.title.replace("mean + ", "mean +\n"), justify="right", max_width=NUMBER_WIDTH)
    grid.add_column(table.columns[5].title, justify="right", min_width=FIGURE_WIDTH)
    grid.add_column(table.columns[6].title, justify="right", no_wrap=True)
    for row in table.rows:
        grid.add_row(Text(_with_unit(row)), *(Text(cell.text) for cell in row[2:7]))
    return _Fitting(grid)


def _verdicts(table: Table) -> RenderableType:
    grid = _grid("verdict", min_width=VERDICT_WIDTH)
    grid.add_column("figure", min_width=FIGURE_WIDTH)
    grid.add_column("limit", justify="right", no_wrap=True)
    grid.add_column("value", justify="right", max_width=NUMBER_WIDTH)
    grid.add_column("n", justify="right", no_wrap=True)
    for verdict, head, unit, limit, value, _, count, _ in table.rows:
        style = VERDICTS.get(verdict.text, OPEN).colour
        bound = f"{limit.text} {unit.text}"
        words = (head.text, bound, value.text, count.text)
        grid.add_row(Text(f"{verdict.icon} {verdict.text}", style), *map(Text, words))
    return _Fitting(grid)


def _now(state: LiveState) -> Iterator[str]:
    """Say where the rover is and how the sub-trajectory under way stands."""
    rows = state.path.rows
    if rows:
        row, node = rows[-1], state.nodes.get("localisation_node")
        word = "lost" if row.lost else (node.state if node is not None else "")
        driven = f"{number(row.distance_m, unit=METRE)} m driven"
        place = " ".join(f"{value:.3f}" for value in row.position)
        yield f"pose {row.n + 1}: {one_line(word) or 'state unknown'}, at {place} m, {driven}"
        if row.error is not None:
            error = " ".join(number(value, signed=True) for value in row.error)
            yield f"error x y z: {error} m"
    under_way = state.path.under_way
    if under_way is not None:
        size = number(sum(value * value for value in under_way.error) ** 0.5)
        yield f"under way: {under_way.condition}, {under_way.progress:.0%}, error {size} m"


def _nodes(state: LiveState, now_s: float) -> RenderableType:
    calls = {call.node: call for call in state.calls}
    grid = _grid("node")
    grid.add_column("health")
    grid.add_column("state")
    for title in ("call", "memory", "dropped", "heard"):
        grid.add_column(title, justify="right", no_wrap=True)
    for name in sorted(state.nodes):
        node, call = state.nodes[name], calls.get(name)
        plain = node.to_plain(now_s)
        icon, style = LEVELS[plain["level"]]
        health = Text(f"{icon} {plain['level']}", style)
        if plain["lifecycle"] not in ("active", "unknown"):
            health.append(f", {one_line(plain['lifecycle'])}")
        took, memory = _call_words(call) if call is not None else (ABSENT, ABSENT)
        heard = _age(now_s - node.heard_s) if node.heard_s else "never"
        words = (node.state, took, memory, str(sum(_drops(node).values())), heard)
        grid.add_row(Text(one_line(name)), health, *(Text(one_line(word)) for word in words))
    return _Fitting(grid)


def _level(node: NodeView, now_s: float) -> str:
    return str(node.to_plain(now_s)["level"])


def _call_words(call: CallSample) -> tuple[str, str]:
    """Return time and memory of a call."""
    took = number(call.times.get("processing_time_s"), ABSENT, MILLISECOND)
    memory = ABSENT if call.memory_bytes is None else f"{number(call.memory_bytes, unit=MIB)} MiB"
    return f"{took} ms", memory


def _notes(state: LiveState) -> Iterator[str]:
    """Say what is wrong with nodes, what was dropped and why, how late things are, what could not be read."""
    for name in sorted(state.nodes):
        yield from _notes_of(state.nodes[name])
    lost = {topic: count for topic, count in state.lost.items() if count}
    if lost:
        yield "not received here: " + ", ".join(f"{count} of {topic}" for topic, count in lost.items())
    if state.report is not None:
        yield from (f"warning: {one_line(text)}" for text in state.report.warnings)
    if state.problems:
        yield f"not readable: {state.problems[-1]}"


def _notes_of(node: NodeView) -> Iterator[str]:
    name, health = one_line(node.name), node.health
    if health is None:
        return
    if health.level:
        yield f"{name}: {one_line(health.message)}"
    drops = [f"{count} {cause}" for cause, count in _drops(node).items() if count]
    if drops:
        yield f"{name} dropped: {', '.join(drops)}"
    late = list(_latencies(node))
    if late:
        yield f"{name} p95: {', '.join(late)}"


def _drops(node: NodeView) -> dict[str, int]:
    """Return how much a node has dropped, by cause."""
    values = {} if node.health is None else node.health.values
    return {
        name.removeprefix(DROPPED).replace("_", " "): int(text)
        for name, text in values.items()
        if name.startswith(DROPPED) and text.isdecimal()
    }


def _latencies(node: NodeView) -> Iterator[str]:
    values = {} if node.health is None else node.health.values
    for name, text in values.items():
        if not (name.startswith(LATENCY) and name.endswith(P95)):
            continue
        try:
            took = number(float(text), unit=MILLISECOND)
        except (ValueError, OverflowError):
            continue
        yield f"{name.removeprefix(LATENCY).removesuffix(P95).replace('_', ' ')} {took} ms"


def _figure_words(row: Row) -> str:
    mean, sigma, bound, interval, count = (cell.text for cell in row[2:7])
    return f"{_with_unit(row)} mean {mean} sigma {sigma} mean + 3 sigma {bound} ({interval}, n {count})"


def _with_unit(row: Row) -> str:
    return f"{row[0].text}, {row[1].text}" if row[1].text else row[0].text


def _age(seconds: float) -> str:
    return f"{max(seconds, 0.0):.1f} s"


class _Fitting:
    """A table without the columns at its right that find no room: half a number would be another one."""

    def __init__(self, grid: Grid) -> None:
        self._grid = grid

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        while len(self._grid.columns) > 2 and not self._is_whole(console, options):
            self._grid.columns.pop()
        yield self._grid

    def _is_whole(self, console: Console, options: ConsoleOptions) -> bool:
        """Tell whether every word is drawn, none of them cut."""
        lines = console.render_lines(self._grid, options.update(height=None), pad=False)
        drawn = {word for line in lines for word in "".join(segment.text for segment in line).split()}
        texts = (str(text) for column in self._grid.columns for text in (column.header, *column.cells))
        return {word for text in texts for word in text.split()} <= drawn


def _grid(first: str, min_width: int | None = None) -> Grid:
    """Return a table without lines, with its first column."""
    grid = Grid(box=None, pad_edge=False, padding=(0, 1, 0, 0), header_style="bold", expand=False)
    grid.add_column(first, min_width=min_width)
    return grid
