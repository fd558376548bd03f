"""What `sfr live` shows, from running nodes or from a recording: a page or a terminal, beside them Foxglove."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

from sfr_loc_map.errors import InterruptedRunError

if TYPE_CHECKING:
    from pathlib import Path

    from sfr_loc_map.live.commands import Operator
    from sfr_loc_map.live.config import LiveConfig
    from sfr_loc_map.live.hub import Hub
    from sfr_loc_map.metrics.config import ScoreConfig
    from sfr_loc_map.metrics.limits import Limits


@dataclass(frozen=True, slots=True)
class Views:
    """Where a run is shown.

    Attributes:
        page: How the page is served; None: on the terminal.
        open_browser: Whether to open the page in the user's browser.
        foxglove_port: Port to serve the Foxglove protocol on beside it; None: not.
    """

    page: LiveConfig | None
    open_browser: bool = False
    foxglove_port: int | None = None


@dataclass(frozen=True, slots=True)
class Played:
    """A recording that is shown.

    Attributes:
        path: Where it is.
        truth: Source with its truth, None where it has one.
        rate: Multiple of the recorded speed.
        score: Settings of the score.
        limits: Limits to judge by.
    """

    path: Path
    truth: Path | None
    rate: float
    score: ScoreConfig
    limits: Limits | None


def show_graph(namespace: str, views: Views) -> None:
    """Show the running nodes.

    Args:
        namespace: Of the rover.
        views: Where.

    Raises:
        SfrError: If the port cannot be listened on, or others are let in without a token.
        InterruptedRunError: If a signal has ended the view on the terminal.
    """
    from sfr_loc_map.live.hub import Hub
    from sfr_loc_map.nodes.live.feed import RosFeed

    hub, title = Hub(), namespace or "live"
    with _beside(hub, views, title) as fed, RosFeed(fed, namespace) as feed:
        _show(hub, views, title, feed.operator)


def show_recording(played: Played, views: Views) -> None:
    """Play a recording and show it.

    Raises:
        SfrError: If there is nothing to play, or as in `show_graph`.
    """
    from sfr_loc_map.live.hub import Hub
    from sfr_loc_map.live.playback.player import Playback, Player
    from sfr_loc_map.live.playback.recorded_files import open_recording

    recording = open_recording(played.path, played.truth)
    hub = Hub()
    with _beside(hub, views, recording.title) as fed:
        playback = Playback(fed, recording, played.score, played.limits)
        with Player(playback, fed, recording.end_s, played.rate) as player:
            _show(hub, views, recording.title, player)


@contextmanager
def _beside(hub: Hub, views: Views, title: str) -> Iterator[Hub]:
    """Serve Foxglove during the block where that is wanted; yield the hub that is to be fed."""
    if views.foxglove_port is None:
        yield hub
        return
    from sfr_loc_map.live.foxglove.view import FoxgloveView
    from sfr_loc_map.live.hub import Hub
    from sfr_loc_map.live.tee import Tee

    other = Hub()
    with FoxgloveView(other, views.foxglove_port, title) as served:
        print(f"foxglove: {served.url}", flush=True)
        yield Tee((hub, other))


def _show(hub: Hub, views: Views, title: str, operator: Operator) -> None:
    if views.page is None:
        from sfr_loc_map.cli.output import TolerantFile
        from sfr_loc_map.live.terminal import Terminal

        TolerantFile.reader_needed = True
        with _interrupted():
            Terminal(hub, title, operator).show()
        return
    import asyncio

    from sfr_loc_map.live.serve import serve_until_signal
    from sfr_loc_map.live.server import LiveServer

    server = LiveServer(views.page, hub, operator, title)
    asyncio.run(serve_until_signal(server, open_browser=views.open_browser))


@contextmanager
def _interrupted() -> Iterator[None]:
    """Say what SIGINT has ended: the view alone.

    Raises:
        InterruptedRunError: On SIGINT.
    """
    try:
        yield
    except KeyboardInterrupt:
        raise InterruptedRunError("interrupted: the view has ended, nothing else") from None
