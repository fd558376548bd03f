"""What `sfr live` shows beside the page, and from where."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from sfr_loc_map.errors import InterruptedRunError


def show_graph(namespace: str) -> None:
    """Show the running nodes on the terminal until q is pressed.

    Args:
        namespace: Of the rover.

    Raises:
        InterruptedRunError: On SIGINT or SIGTERM.
    """
    from sfr_loc_map.live.hub import Hub
    from sfr_loc_map.live.terminal import Terminal
    from sfr_loc_map.nodes.live.feed import RosFeed

    hub = Hub()
    with view_interrupted(), RosFeed(hub, namespace):
        Terminal(hub, namespace).show()


@contextmanager
def view_interrupted() -> Iterator[None]:
    """Say what SIGINT has ended: the view alone.

    Raises:
        InterruptedRunError: On SIGINT.
    """
    try:
        yield
    except KeyboardInterrupt:
        raise InterruptedRunError("interrupted: the view has ended, nothing else") from None
