"""Load tests of the live page that no test suite has time for: `make live-soak`.

python test/live/soak.py clients [MINUTES]
    five pages, one that never reads, one that connects again each second, beside a replay of the sample at 10 Hz in a
    loop; in six rounds, each begins with up to a minute without pages
python test/live/soak.py load [SECONDS]
    stereo images of 1 MP at 10 Hz and a cloud of a million points each 5 s
"""

from __future__ import annotations

import asyncio
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import aiohttp
import numpy as np
import psutil

ROOT = Path(__file__).resolve().parents[2]
SFR = (sys.executable, "-c", "from sfr_loc_map.cli.main import main; raise SystemExit(main())")
ALONE_S = 60.0
ROUNDS = 6
VIEWS = {"type": "want", "views": ["images", "clouds", "tracks"]}


class Page:
    """One page that looks on and counts."""

    def __init__(self, url: str) -> None:
        self.url = url
        self.calls: list[dict[str, Any]] = []
        self.rows: list[tuple[int, float, float | None]] = []
        self.figures = self.media = 0
        self.headers: dict[str, dict[str, Any]] = {}

    async def look(self, session: aiohttp.ClientSession, seconds: float, *, views: bool = True) -> None:
        end = time.monotonic() + seconds
        async with session.ws_connect(self.url + "ws", max_msg_size=0) as channel:
            if views:
                await channel.send_json(VIEWS)
            while (left := end - time.monotonic()) > 0:
                try:
                    message = await asyncio.wait_for(channel.receive(), left)
                except TimeoutError:
                    return
                if message.type is aiohttp.WSMsgType.TEXT:
                    self._take(json.loads(message.data), len(message.data))
                elif message.type is aiohttp.WSMsgType.BINARY:
                    self.media += len(message.data)
                    size = int.from_bytes(message.data[:4], "little")
                    header = json.loads(message.data[4 : 4 + size])
                    self.headers[header["topic"]] = header
                else:
                    return

    def _take(self, message: dict[str, Any], size: int) -> None:
        self.figures += size
        if message["type"] == "calls" and not message["whole"]:
            self.calls += [call for call in message["calls"] if call["node"] == "localisation_node"]
        if message["type"] == "path" and not message["whole"]:
            self.rows += [(row[0], time.time(), row[3]) for row in message["rows"]]


async def never_reads(session: aiohttp.ClientSession, url: str, seconds: float) -> None:
    """Connect, ask for everything, read nothing."""
    port = int(url.rsplit(":", 1)[1].strip("/"))
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        _, writer = await asyncio.open_connection("127.0.0.1", port, limit=1024)
        request = f"GET /ws HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        writer.write(f"{request}Sec-WebSocket-Key: {'A' * 22}==\r\nSec-WebSocket-Version: 13\r\n\r\n".encode())
        text = json.dumps(VIEWS).encode()
        writer.write(bytes([0x81, 0x80 | len(text), 0, 0, 0, 0]) + text)
        await writer.drain()
        writer.transport.pause_reading()
        await asyncio.sleep(min(30.0, end - time.monotonic()))
        writer.transport.abort()


async def reconnects(session: aiohttp.ClientSession, url: str, seconds: float) -> int:
    """Connect again each second; return how often the full state came."""
    end, whole = time.monotonic() + seconds, 0
    while time.monotonic() < end:
        page = Page(url)
        await page.look(session, 1.0)
        whole += page.figures > 0
    return whole


def p95_ms(calls: list[dict[str, Any]], name: str = "processing_time_s") -> float:
    values = [call[name] for call in calls if name in call]
    return float(np.quantile(values, 0.95) * 1e3) if values else float("nan")


async def state_of(session: aiohttp.ClientSession, url: str) -> dict[str, Any]:
    async with session.get(url + "state.json") as answer:
        return dict((await answer.json())["live"])


def server_process(parent: int) -> psutil.Process:
    """Return the process of the page beside a replay."""
    children = psutil.Process(parent).children(recursive=True)
    return next(child for child in children if "nodes.live_page" in " ".join(child.cmdline()))


async def clients(minutes: float) -> None:
    seconds = minutes * 60.0 / ROUNDS
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "log"
        with log.open("wb") as stream:
            options = ("--start", "truth", "--rate", "5", "--loop", "--live", "--live-port", "0")
            command = (*SFR, "replay", "sample/sample.mcap", *options)
            to = {"stdout": stream, "stderr": subprocess.STDOUT, "env": _environment(), "start_new_session": True}
            replay = subprocess.Popen(command, cwd=ROOT, **to)
        try:
            url = await _address(log)
            server = server_process(replay.pid)
            async with aiohttp.ClientSession() as session:
                while not (await state_of(session, url))["poses"]:
                    await asyncio.sleep(0.5)
                alone, pages, memory, count = Page(url), [Page(url) for _ in range(3)], [server.memory_info().rss], 0
                for _ in range(ROUNDS):
                    await alone.look(session, min(seconds, ALONE_S), views=False)
                    looking = [page.look(session, seconds) for page in pages]
                    others = [never_reads(session, url, seconds), reconnects(session, url, seconds)]
                    *_, again, _ = await asyncio.gather(*looking, *others, _watch_memory(server, memory, seconds))
                    count += again
                state = await state_of(session, url)
        finally:
            replay.terminate()
            replay.wait(30)
    busy = pages[0].calls
    lost = {node["name"]: node["values"].get("dropped_in_transport") for node in state["nodes"]}
    parts = [f"{np.mean(part) / 1e6:.1f}" for part in np.array_split(np.array(memory[1:]), ROUNDS)]
    print(f"{minutes:g} minutes, {len(alone.calls)} calls before, {len(busy)} with five pages, {count} reconnections")
    print(f"localisation p95: {p95_ms(alone.calls):.1f} ms without pages, {p95_ms(busy):.1f} ms with")
    most = max(memory) / 1e6
    print(f"server memory: {memory[0] / 1e6:.1f} MB before, then means of {', '.join(parts)} MB, at most {most:.1f}")
    media, figures = (size / seconds / ROUNDS for size in (pages[0].media / 1e6, pages[0].figures / 1e3))
    print(f"each page: {media:.2f} MB/s of images and clouds, {figures:.1f} kB/s of figures")
    print(f"lost in transport to the nodes: {lost}; the server: {state['server']}")


async def _watch_memory(server: psutil.Process, memory: list[int], seconds: float) -> None:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        await asyncio.sleep(1.0)
        memory.append(server.memory_info().rss)


def _environment() -> dict[str, str]:
    return {name: value for name, value in os.environ.items() if name != "ROS_DOMAIN_ID"} | {"PYTHONPATH": str(ROOT)}


async def _address(log: Path) -> str:
    for _ in range(1200):
        if found := re.search(r"live: (\S+)", log.read_text(errors="replace")):
            return found[1]
        await asyncio.sleep(0.1)
    raise TimeoutError(log.read_text(errors="replace"))


async def load(seconds: float) -> None:
    from load_publisher import publish_load

    os.environ["ROS_DOMAIN_ID"] = "93"
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "log"
        with log.open("wb") as stream:
            environment = _environment() | {"ROS_DOMAIN_ID": "93"}
            page = subprocess.Popen(
                (*SFR, "live", "--port", "0"), stdout=stream, stderr=subprocess.STDOUT, env=environment
            )
        try:
            url = await _address(log)
            async with aiohttp.ClientSession() as session:
                found = Page(url)
                looking = asyncio.create_task(found.look(session, seconds + 4.0))
                await asyncio.sleep(2.0)
                sent = await asyncio.to_thread(publish_load, seconds)
                await looking
                state = await state_of(session, url)
        finally:
            page.terminate()
            page.wait(30)
    lags = sorted(at - published for _, at, published in found.rows if published)
    lag = (
        f"{lags[len(lags) // 2] * 1e3:.0f} ms, 95 % within {lags[int(len(lags) * 0.95)] * 1e3:.0f} ms"
        if lags
        else "unknown"
    )
    print(f"{sent} poses sent, {state['poses']} received, {len(found.rows)} sent to the page as they came; delay {lag}")
    for name, header in sorted(found.headers.items()):
        print(f"  {name}: { ({key: header[key] for key in ('size', 'full_size', 'count', 'total') if key in header}) }")
    print(f"{found.media / (seconds + 4.0) / 1e6:.2f} MB/s of images and clouds; the server: {state['server']}")


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parent))
    kind, amount = sys.argv[1], sys.argv[2:]
    asyncio.run(clients(float(*amount or [30])) if kind == "clients" else load(float(*amount or [60])))
