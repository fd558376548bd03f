"""How soon a real browser shows what goes wrong in a real graph: `make live-screen`.

python test/live/on_failure.py
    kills and stops the nodes of `sfr run --respawn`, and replays the sample with black pairs in it; prints after how
    many seconds the page has shown each failure and that it is over
"""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import psutil
from browser import Browser
from on_screen import ROOT, SFR, address

NODES = ("monitor_node", "mapping_node", "localisation_node")
WATCH = """window.told = [];
new MutationObserver(() => told.push([sfrLive.connection.now(), document.getElementById('state').textContent.trim()]))
    .observe(document.getElementById('state'), { subtree: true, characterData: true, childList: true })"""
"""Writes down when the state in the header changes."""
CARDS = "[...document.querySelectorAll('#nodes .node')]"
ALL_HEARD = f"{CARDS}.length === 3 && !{CARDS}.some((card) => card.querySelector('b').textContent.startsWith('stale'))"


def started(log: Path, *words: str) -> subprocess.Popen[bytes]:
    environment = {name: value for name, value in os.environ.items() if name != "ROS_DOMAIN_ID"}
    environment |= {"PYTHONPATH": str(ROOT), "ROS_DOMAIN_ID": "91"}
    with log.open("wb") as stream:
        return subprocess.Popen((*SFR, *words), cwd=ROOT, stdout=stream, stderr=subprocess.STDOUT, env=environment)


async def kill_nodes(folder: Path) -> None:
    run = started(folder / "run.log", "run", "all", "--live", "--live-port", "0", "--respawn")
    try:
        url = await address(folder / "run.log")
        async with Browser(1360, 3600) as browser:
            await browser.open(url)
            for name in NODES:
                await browser.wait_for(ALL_HEARD, 120)
                await asyncio.sleep(2.5)
                await _time(browser, run.pid, name, signal.SIGKILL)
            await browser.wait_for(ALL_HEARD, 120)
            await _time(browser, run.pid, "monitor_node", signal.SIGSTOP)
            print(f"complaints of the page: {browser.complaints()}")
    finally:
        run.terminate()
        run.wait(30)


async def _time(browser: Browser, run: int, name: str, number: signal.Signals) -> None:
    (node,) = (child for child in psutil.Process(run).children(recursive=True) if f"nodes.{name}" in _words(child))
    begin = time.monotonic()
    node.send_signal(number)
    short = name.removesuffix("_node")
    await browser.wait_for(
        f"{CARDS}.find((card) => card.textContent.includes('{short}')).textContent.includes('stale')"
    )
    shown = time.monotonic() - begin
    await browser.wait_for(f"document.getElementById('nodes-pill').textContent.includes('{short}')")
    if number is signal.SIGSTOP:
        node.send_signal(signal.SIGCONT)
    await browser.wait_for(ALL_HEARD, 120)
    print(f"{number.name} to {name}: shown after {shown:.2f} s, back after {time.monotonic() - begin:.2f} s")


def _words(process: psutil.Process) -> str:
    try:
        return "" if process.status() == psutil.STATUS_ZOMBIE else " ".join(process.cmdline())
    except psutil.Error:
        return ""


async def lose_localisation(folder: Path) -> None:
    """Replay the sample with eight black pairs, and compare when they were published with when the page said so."""
    bag = folder / "lost.mcap"
    fault = "black:share=0.08,burst=8,start=30"
    command = (*SFR, "perturb", "sample/sample.mcap", str(bag), "--fault", fault)
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True, env=os.environ | {"PYTHONPATH": str(ROOT)})
    options = ("--start", "truth", "--rate", "1", "--live", "--live-port", "0")
    replay = started(folder / "replay.log", "replay", str(bag), *options)
    try:
        url = await address(folder / "replay.log")
        async with Browser(1360, 3600) as browser:
            await browser.open(url)
            await browser.wait_for("window.sfrLive && document.readyState === 'complete'")
            await browser.value(WATCH)
            framed = False
            while not await browser.value("sfrLive.store.ended"):
                framed |= await browser.value("Boolean(document.querySelector('.frame.lost'))")
                await asyncio.sleep(0.05)
            rows = await browser.value("sfrLive.store.rows.map((row) => [row.published, row.lost])")
            told = await browser.value("told")
            print(f"lost pairs {sum(lost for _, lost in rows)} of {len(rows)}; {_delays(rows, told)}")
            after = await browser.value("Boolean(document.querySelector('.frame.lost'))")
            print(f"red frame around the images: {framed}, at the end: {after}")
    finally:
        replay.terminate()
        replay.wait(30)


def _delays(rows: Sequence[Any], told: Sequence[Any]) -> str:
    """Return how long after the first lost pair, and the first found one, the header said so."""
    places = [place for place, (_, lost) in enumerate(rows) if lost]
    lost_s, found_s = rows[places[0]][0], rows[places[-1] + 1][0]
    said = next(at for at, text in told if at > lost_s and "lost" in text)
    over = next(at for at, text in told if at > found_s and "lost" not in text)
    return f"lost is shown {said - lost_s:.2f} s after its first pair, found again {over - found_s:.2f} s after its own"


async def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        print(f"load {os.getloadavg()[0]:.1f}")
        await lose_localisation(Path(name))
        await kill_nodes(Path(name))
        print(f"load {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    asyncio.run(main())
