"""What a real browser shows of a real replay: `make live-screen`.

python test/live/on_screen.py [RATE] [FOLDER]
    replays the sample with its live page in Chromium at a multiple of its speed (5: 10 Hz), checks that every panel is
    drawn and that the figures are those of `state.json` and, after the end, of the final report; prints how long it
    took from image to screen, part by part, and what each process used of the processor; with FOLDER it writes
    live-light.webp, live-dark.webp and live-phone.webp there
"""

from __future__ import annotations

import asyncio
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
from browser import Browser

from sfr_loc_map.live.report_view import ReportView

ROOT = Path(__file__).resolve().parents[2]
SFR = (sys.executable, "-c", "from sfr_loc_map.cli.main import main; raise SystemExit(main())")
LIMITS = """
trajectory:
  - condition: distance=2
    position_mean_plus_3sigma_m: 0.02
    attitude_mean_plus_3sigma_deg: 0.1
    heading_mean_plus_3sigma_deg: 0.1
map: {point_error_p95_m: 0.6}
timing: {localisation_p95_s: 0.5}
"""
SHOWN = """Object.fromEntries([...document.querySelectorAll('td[data-key]')]
    .map((cell) => [`${cell.dataset.key} ${cell.closest('details')?.dataset.name ?? 'live'}`, cell.textContent]))"""
"""All figures on the page by key and table."""
PANELS = (
    "document.querySelectorAll('#figure-table td[data-key]').length > 10",
    "document.getElementById('path-canvas').dataset.poses > 10",
    *(
        f"document.getElementById('{name}-canvas').dataset.points > 10"
        for name in ("error", "time", "transport", "receive", "memory")
    ),
    "document.querySelectorAll('#images canvas:not([hidden])').length === 2",
    "document.querySelector('#images canvas').dataset.tracks > 10",
    "['sigma', 'hazard', 'error'].every((name) => sfrLive.store.elevation.names.includes(name))",
    "document.getElementById('map-canvas').dataset.cells > 100",
    "document.getElementById('cloud-canvas').dataset.points > 1000",
    "document.querySelectorAll('#nodes .node').length === 3",
    "document.querySelectorAll('#tables table').length > 3",
)
PARTS = ("latency_transport_s", "latency_receive_to_publish_s", "processing_time_s", "conversion_s")
RECEIVED = "sfrLive.store.rows.filter((row) => row.published).map((row) => [row.stamp, row.received - row.published])"
SCREENS = (("light", 1360, "light"), ("dark", 1360, "dark"), ("phone", 400, "light"))


class Usage:
    """Processor time by process since a moment."""

    def __init__(self, parents: list[int]) -> None:
        self._parents = parents
        self._begin, self._at = self._seconds(), time.monotonic()

    def _seconds(self) -> dict[tuple[int, str], float]:
        found: dict[tuple[int, str], float] = {}
        for parent in self._parents:
            process = psutil.Process(parent)
            for one in (process, *process.children(recursive=True)):
                try:
                    used, words = one.cpu_times(), " ".join(one.cmdline())
                except psutil.Error:
                    continue
                name = re.search(r"process\.start nodes\.([a-z_.]+)|(chromium)", words)
                found[one.pid, next(filter(None, name.groups())) if name else "replay"] = used.user + used.system
        return found

    def text(self) -> str:
        passed = time.monotonic() - self._at
        shares: dict[str, float] = {}
        for key, seconds in self._seconds().items():
            shares[key[1]] = shares.get(key[1], 0.0) + (seconds - self._begin.get(key, 0.0)) / passed
        return ", ".join(f"{name} {100 * share:.0f} %" for name, share in sorted(shares.items(), key=lambda kv: -kv[1]))


async def show(rate: float, folder: Path | None) -> None:
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        (place / "limits.yaml").write_text(LIMITS)
        async with Browser(1360, 1000) as browser, aiohttp.ClientSession() as session:
            begin = time.monotonic()
            replay = start_replay(place, rate)
            try:
                url = await address(place / "log")
                await browser.open(url)
                await browser.wait_for("document.readyState === 'complete' && window.sfrLive")
                print(f"page up {time.monotonic() - begin:.2f} s after the command, load {os.getloadavg()[0]:.1f}")
                await _look(browser, session, url, replay.pid)
                if folder is not None:
                    folder.mkdir(parents=True, exist_ok=True)
                    for kind, width, scheme in SCREENS:
                        await _screenshot(browser, folder / f"live-{kind}.webp", width, scheme)
                await asyncio.to_thread(replay.wait, 120)
                await _compare_with_report(browser, place / "out")
            finally:
                replay.terminate()
                replay.wait(30)
                if replay.returncode not in (0, 1):
                    print((place / "log").read_text()[-2000:])


def start_replay(place: Path, rate: float) -> subprocess.Popen[bytes]:
    """Start the replay with its page; what it writes goes to `log`, its report to `out`."""
    options = ("--start", "truth", "--rate", str(rate), "--live", "--live-port", "0", "--out", str(place / "out"))
    scored = ("--condition", "distance=2", "--limits", str(place / "limits.yaml"))
    environment = {name: value for name, value in os.environ.items() if name != "ROS_DOMAIN_ID"}
    with (place / "log").open("wb") as log:
        return subprocess.Popen(
            (*SFR, "replay", "sample/sample.mcap", *options, *scored),
            cwd=ROOT,
            stdout=log,
            stderr=subprocess.STDOUT,
            env=environment | {"PYTHONPATH": str(ROOT)},
        )


async def _look(browser: Browser, session: aiohttp.ClientSession, url: str, replay: int) -> None:
    """Follow the page until the run ends; compare it with state.json while it goes on."""
    await browser.wait_for("sfrLive.store.rows.length > 5", 120)
    usage, equal, looks, text = Usage([replay, browser.process.pid]), 0, 0, ""
    while not await browser.value("sfrLive.store.ended"):
        equal, looks = equal + await _equals_state(browser, session, url), looks + 1
        text = usage.text()
        await asyncio.sleep(0.5)
    print(f"load {os.getloadavg()[0]:.1f}; {text}")
    print(f"figures equal to state.json in {equal} of {looks} looks, in the others the report changed between them")
    await _print_lags(browser)
    await browser.set_size(1360, 4000)
    for condition in PANELS:
        await browser.wait_for(condition)
    print(f"all {len(PANELS)} panels drawn; complaints: {browser.complaints()}")


async def _equals_state(browser: Browser, session: aiohttp.ClientSession, url: str) -> bool:
    """Tell whether the figures on the page are those of state.json right before or after."""
    shown = None
    for _ in range(2):
        try:
            async with session.get(url + "state.json") as answer:
                wanted = _figures((await answer.json())["live"]["tables"])
        except (aiohttp.ClientError, OSError):
            return False
        if wanted == shown:
            return True
        shown = await browser.value(SHOWN)
        if wanted == shown:
            return True
    return False


def _figures(tables: list[dict[str, Any]]) -> dict[str, str]:
    cells = ((table["name"], cell) for table in tables for row in table["rows"] for cell in row)
    return {f"{cell['key']} {name}": cell.get("text", "") for name, cell in cells if "key" in cell}


async def _print_lags(browser: Browser) -> None:
    calls = await browser.value("sfrLive.store.calls.filter((call) => call.node === 'localisation_node')")
    for name in PARTS:
        print(f"  {name[:-2]}: {_spread([call[name] for call in calls if name in call])}")
    lags = await browser.value("({poses: sfrLive.lag.poses, images: sfrLive.lag.images})")
    for name, kept in lags.items():
        print(f"  image published to {name} on the screen: {_spread([seconds for seconds, _ in kept])}")
    received = dict(await browser.value(RECEIVED))
    rest = [seconds - received[stamp] for seconds, stamp in lags["poses"] if stamp in received]
    print(f"  of that of poses from the server to the screen: {_spread(rest)}")


def _spread(seconds: list[float]) -> str:
    low, high = np.quantile(seconds, (0.5, 0.95)) * 1e3
    return f"p50 {low:.0f} ms, p95 {high:.0f} ms ({len(seconds)})"


async def _compare_with_report(browser: Browser, out: Path) -> None:
    """Compare the figures that the page keeps with those of the final report."""
    wanted = _figures(ReportView.read((out / "report.json").read_text(), 0.0).to_plain()["tables"])
    shown = await browser.value(SHOWN)
    differ = {key: (shown.get(key), wanted[key]) for key in wanted if shown.get(key) != wanted[key]}
    print(f"{len(wanted) - len(differ)} of {len(wanted)} figures of the final report are on the page; others: {differ}")


async def _screenshot(browser: Browser, path: Path, width: int, scheme: str) -> None:
    """Write the whole page, reduced."""
    mobile = width < 760
    await browser.set_scheme(scheme)
    await browser.set_size(width, 900, mobile=mobile)
    await asyncio.sleep(1.0)
    height = await browser.value("document.body.scrollHeight")
    await browser.set_size(width, min(height, 5200), mobile=mobile)
    await asyncio.sleep(1.5)
    await browser.screenshot(path, scale=1.0 if mobile else 0.75)


async def address(log: Path) -> str:
    for _ in range(3000):
        if found := re.search(r"live: (\S+)", log.read_text(errors="replace")):
            return found[1]
        await asyncio.sleep(0.02)
    raise TimeoutError(log.read_text(errors="replace"))


if __name__ == "__main__":
    arguments = sys.argv[1:]
    asyncio.run(show(float(arguments[0]) if arguments else 5.0, Path(arguments[1]) if arguments[1:] else None))
