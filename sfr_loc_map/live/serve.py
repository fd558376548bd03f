"""Serves the page as the program of a process: until a signal, with its address on standard output."""

from __future__ import annotations

import asyncio
import signal
import webbrowser

from sfr_loc_map.live.server import LiveServer


async def serve_until_signal(server: LiveServer, *, open_browser: bool = False, farewell_s: float = 0.0) -> None:
    """Serve until SIGINT or SIGTERM; print the address when the page can be opened."""
    task = asyncio.ensure_future(server.serve(lambda url: announce(url, open_browser=open_browser)))
    loop = asyncio.get_running_loop()

    def end() -> None:
        if server.is_over or not farewell_s:
            task.cancel()
        server.end()
        loop.call_later(farewell_s, task.cancel)

    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, end)
    try:
        await task
    except asyncio.CancelledError:
        return


def announce(url: str, *, open_browser: bool) -> None:
    """Say where the page is."""
    print(f"live: {url}", flush=True)
    if open_browser:
        webbrowser.open(url)
