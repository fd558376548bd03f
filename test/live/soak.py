"""Loads the live page as no test suite has time for: `make live-soak`.

python test/live/soak.py [MINUTES]
    three pages and one that never reads, beside a replay of the sample at 10 Hz in a loop; in six rounds, each begins
    with a minute without pages
"""

from __future__ import annotations

import asyncio
import json
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import aiohttp
import psutil
from on_screen import LIVE, SAMPLE, address, spread, started

ALONE_S, ROUNDS = 60.0, 6
VIEWS = {"type": "want", "views": ["images", "clouds", "tracks"]}


class Page:
    """One page that looks on and counts."""

    def __init__(self) -> None:
        self.took: list[float] = []
        self.media = 0

    async def look(self, url: str, seconds: float, *, views: bool = True) -> None:
        end = time.monotonic() + seconds
        async with aiohttp.ClientSession() as session, session.ws_connect(url + "ws", max_msg_size=0) as channel:
            if views:
                await channel.send_json(VIEWS)
            while (left := end - time.monotonic()) > 0:
                try:
                    message = await channel.receive(left)
                except TimeoutError:
                    return
                if message.type is aiohttp.WSMsgType.BINARY:
                    self.media += len(message.data)
                elif message.type is not aiohttp.WSMsgType.TEXT:
                    return
                elif (content := json.loads(message.data))["type"] == "calls" and not content["whole"]:
                    calls = [call for call in content["calls"] if call["node"] == "localisation_node"]
                    self.took += [call["processing_time_s"] for call in calls]


async def never_reads(url: str, seconds: float) -> None:
    """Ask for everything, read nothing; connect again once cut off."""
    end = time.monotonic() + seconds
    while (left := end - time.monotonic()) > 0:
        async with aiohttp.ClientSession() as session, session.ws_connect(url + "ws", max_msg_size=0) as channel:
            await channel.send_json(VIEWS)
            await asyncio.sleep(min(30.0, left))


async def state_of(url: str) -> dict[str, Any]:
    async with aiohttp.ClientSession() as session, session.get(url + "state.json") as answer:
        return dict((await answer.json())["live"])


async def clients(place: Path, minutes: float) -> None:
    seconds, memory = minutes * 60.0 / ROUNDS, list[str]()
    alone, pages = Page(), [Page() for _ in range(3)]
    replay = started(place / "log", "replay", SAMPLE, "--start", "truth", "--rate", "5", "--loop", *LIVE)
    os.nice(10)  # the pages would be on other machines
    try:
        url = await address(place / "log")
        children = psutil.Process(replay.pid).children(recursive=True)
        server = next(child for child in children if "nodes.live_page" in " ".join(child.cmdline()))
        while not (await state_of(url))["poses"]:
            await asyncio.sleep(0.5)
        for _ in range(ROUNDS):
            await alone.look(url, min(ALONE_S, seconds), views=False)
            await asyncio.gather(never_reads(url, seconds), *(page.look(url, seconds) for page in pages))
            memory.append(f"{server.memory_info().rss / 1e6:.1f}")
        state = await state_of(url)
    finally:
        replay.terminate()
        replay.wait(30)
    print(f"localisation: {spread(alone.took)} without pages, {spread(pages[0].took)} with")
    print(f"server memory after each round: {', '.join(memory)} MB; the server: {state['server']}")
    print(f"each page: {pages[0].media / seconds / ROUNDS / 1e6:.2f} MB/s of images and clouds")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        asyncio.run(clients(Path(folder), float((*sys.argv[1:], "30")[0])))
