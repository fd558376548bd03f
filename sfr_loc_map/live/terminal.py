"""A run shown on a terminal while it goes on, for a shell far away; lines, where there is no terminal."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from threading import Thread

from rich.console import Console, RenderableType
from rich.layout import Layout
from rich.live import Live
from rich.text import Text

from sfr_loc_map.errors import SfrError
from sfr_loc_map.inputs import one_line
from sfr_loc_map.live.commands import Action, Command, Operator
from sfr_loc_map.live.hub import Hub
from sfr_loc_map.live.state import LiveState
from sfr_loc_map.live.terminal_screen import line, screen
from sfr_loc_map.pipeline.controls import SEEK_STEP_S, Keyboard

PERIOD_S = 0.5
"""Time between two drawings of the screen,"""
LINE_PERIOD_S = 1.0
"""or between two lines."""
KEY_PERIOD_S = 0.05


@dataclass(slots=True)
class Keys:
    """What the keys do: q ends; of a player, space pauses and the arrows go back and on.

    Attributes:
        operator: Carries it out, None where nothing plays.
        ended: Whether q was pressed.
        answer: What came of the last key, in words.
    """

    operator: Operator | None = None
    ended: bool = False
    answer: str = ""

    def press(self, key: str, state: LiveState) -> None:
        """Do what a key says."""
        place = state.time_line
        if key in ("q", "Q"):
            self.ended = True
        elif self.operator is None or place is None:
            return
        elif key == " ":
            self._run(Command(Action.PAUSE if place.playing else Action.PLAY))
        elif key in ("left", "right"):
            step = SEEK_STEP_S if key == "right" else -SEEK_STEP_S
            self._run(Command(Action.SEEK, at_s=min(max(place.at_s + step, 0.0), place.end_s)))

    def help(self, state: LiveState) -> str:
        """Return the last line: which keys there are, and where a player is."""
        place = state.time_line
        if place is None:
            return "q ends"
        word = "playing" if place.playing else "at its end" if place.at_s >= place.end_s else "paused"
        return (
            f"{place.at_s:.1f} of {place.end_s:.1f} s, {word}   q ends, space pauses, left and right 5 s  {self.answer}"
        )

    def _run(self, command: Command) -> None:
        Thread(target=self._carry_out, args=(command,), daemon=True).start()

    def _carry_out(self, command: Command) -> None:
        assert self.operator is not None
        try:
            self.operator.run(command)
            self.answer = ""
        except SfrError as error:
            self.answer = one_line(str(error))


class Terminal:
    """Draws what a hub brings, until q is pressed.

    Attributes:
        state: What is known of the run.
    """

    def __init__(self, hub: Hub, title: str, operator: Operator | None = None, console: Console | None = None) -> None:
        """Draw nothing yet.

        Args:
            hub: Where the feed puts what it receives.
            title: What is shown.
            operator: Of a player, None of a live run.
            console: Where to draw; None: standard output.
        """
        self.state = LiveState()
        self._hub, self._title = hub, title
        self._keys = Keys(operator)
        self._console = console or Console(highlight=False)

    def show(self) -> None:
        """Draw until q is pressed.

        Raises:
            KeyboardInterrupt: On SIGINT and SIGTERM; the terminal is as it was before.
        """
        stream = self._console.file
        with suppress(AttributeError, ValueError):
            stream.reconfigure(errors="replace")  # type: ignore[attr-defined]  # a terminal without these signs
        with _sigterm_interrupts():
            if self._console.is_terminal:
                self._draw()
            else:
                self._print_lines()

    def drawing(self, now_s: float) -> RenderableType:
        """Return the whole screen; the last line says how many lines found no room."""
        body = screen(self.state, now_s, self._title)
        console = self._console
        wanted = len(console.render_lines(body, console.options.update(height=None), pad=False))
        hidden = wanted - (console.height - 1)
        words = f"{hidden} lines more: enlarge the window   " if hidden > 0 else ""
        foot = Text(words + self._keys.help(self.state), "reverse", no_wrap=True, overflow="ellipsis")
        layout = Layout()
        layout.split_column(Layout(body), Layout(foot, size=1))
        return layout

    def _draw(self) -> None:
        with Keyboard() as keyboard, Live(console=self._console, screen=True, auto_refresh=False) as drawn:

            def redraw() -> None:
                drawn.update(self.drawing(time.time()), refresh=True)

            self._loop(PERIOD_S, redraw, keyboard.pressed)
        self._console.print(Text(line(self.state, time.time())), soft_wrap=True)

    def _print_lines(self) -> None:
        def write() -> None:
            self._console.print(Text(line(self.state, time.time())), soft_wrap=True)
            self._console.file.flush()

        self._loop(LINE_PERIOD_S, write, list)

    def _loop(self, period_s: float, show: Callable[[], None], pressed: Callable[[], list[str]]) -> None:
        due_s = time.monotonic()
        while not self._keys.ended:
            self.take()
            for key in pressed():
                self._keys.press(key, self.state)
                due_s = 0.0
            if time.monotonic() >= due_s:
                show()
                due_s = time.monotonic() + period_s
            time.sleep(KEY_PERIOD_S)

    def take(self) -> None:
        """Take in what has arrived."""
        for update in self._hub.take():
            self.state.apply(update)


@contextmanager
def _sigterm_interrupts() -> Iterator[None]:
    """Let SIGTERM do what SIGINT does: the terminal must be left as it was."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
