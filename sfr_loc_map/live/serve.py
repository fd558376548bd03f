"""Serves the page as the program of a process: until a signal, with its address on standard output."""

from __future__ import annotations

import asyncio
import gc
import signal
import webbrowser

from sfr_loc_map.live.server import LiveServer

LAST_MESSAGE_S = 0.1
"""Time for the last message to the pages."""


async def serve_until_signal(server: LiveServer, *, open_browser: bool = False) -> None:
    """Serve until SIGINT or SIGTERM; print the address when the page can be opened.

    SIGUSR1 says that the run is over: the pages are told, and can be opened still.
    """
    gc.collect()
    gc.freeze()  # what is imported stays: cycles of pages that have gone are then found soon
    task = asyncio.ensure_future(server.serve(lambda url: announce(url, open_browser=open_browser)))
    loop = asyncio.get_running_loop()

    def end() -> None:
        server.end()
        loop.call_later(LAST_MESSAGE_S, task.cancel)

    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, end)
    loop.add_signal_handler(signal.SIGUSR1, server.end)
    try:
        await task
    except asyncio.CancelledError:
        return


def announce(url: str, *, open_browser: bool) -> None:
    """Say where the page is."""
    print(f"live: {url}", flush=True)
    if open_browser:
        webbrowser.open(url)
