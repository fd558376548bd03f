"""What a real browser shows of a replay of the sample, and how late: `make live-screen`.

python test/live/on_screen.py [RATE] [FOLDER]
    RATE is a multiple of the recorded speed (5: 10 Hz); with FOLDER it writes live-light.webp, live-dark.webp and
    live-phone.webp there
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

import numpy as np
from browser import Browser

from sfr_loc_map.live.state import ReportView

ROOT = Path(__file__).resolve().parents[2]
SFR = (sys.executable, "-c", "from sfr_loc_map.cli.main import main; raise SystemExit(main())")
LIVE = ("--live", "--live-port", "0")
SAMPLE = "sample/sample.mcap"
LIMITS = """
trajectory: [{condition: distance=2, position_mean_plus_3sigma_m: 0.02, heading_mean_plus_3sigma_deg: 0.1}]
map: {point_error_p95_m: 0.6}
timing: {localisation_p95_s: 0.5}
"""
SHOWN = """Object.fromEntries([...document.querySelectorAll('td[data-key]')]
    .map((cell) => [`${cell.dataset.key} ${cell.closest('details')?.dataset.name ?? 'live'}`, cell.textContent]))"""
"""All figures on the page by key and table."""
PANELS = (
    "document.querySelectorAll('#figure-table td[data-key]').length > 10",
    "document.getElementById('path-canvas').dataset.poses > 10",
    "document.querySelector('#images canvas').dataset.tracks > 10",
    "['sigma', 'hazard', 'error'].every((name) => sfrLive.store.elevation.names.includes(name))",
    "document.getElementById('map-canvas').dataset.cells > 100",
    "document.getElementById('cloud-canvas').dataset.points > 1000",
    "document.querySelectorAll('#nodes .node').length === 3",
    "document.querySelectorAll('#tables table').length > 3",
)
SCREENS = (("light", 1360, "light"), ("dark", 1360, "dark"), ("phone", 400, "light"))


def started(log: Path, *words: str, domain: str | None = None) -> subprocess.Popen[bytes]:
    """Start a command that writes to a log."""
    environment = {name: value for name, value in os.environ.items() if name != "ROS_DOMAIN_ID"}
    environment |= {"PYTHONPATH": str(ROOT)} | ({} if domain is None else {"ROS_DOMAIN_ID": domain})
    with log.open("wb") as stream:
        return subprocess.Popen((*SFR, *words), cwd=ROOT, stdout=stream, stderr=subprocess.STDOUT, env=environment)


async def address(log: Path) -> str:
    for _ in range(3000):
        if found := re.search(r"live: (\S+)", log.read_text(errors="replace")):
            return found[1]
        await asyncio.sleep(0.02)
    raise TimeoutError(log.read_text(errors="replace"))


def spread(seconds: list[float]) -> str:
    low, high = np.quantile(seconds or [np.nan], (0.5, 0.95)) * 1e3
    return f"p50 {low:.1f} ms, p95 {high:.1f} ms ({len(seconds)})"


async def show_replay(place: Path, rate: str, folder: Path | None) -> None:
    (place / "limits.yaml").write_text(LIMITS)
    scored = ("--condition", "distance=2", "--limits", str(place / "limits.yaml"), "--out", str(place / "out"))
    begin = time.monotonic()
    replay = started(place / "log", "replay", SAMPLE, "--start", "truth", "--rate", rate, *LIVE, *scored)
    try:
        async with Browser(1360, 1000) as browser:
            await browser.open(await address(place / "log"))
            await browser.wait_for("document.readyState === 'complete' && window.sfrLive")
            print(f"page up {time.monotonic() - begin:.2f} s after the command, load {os.getloadavg()[0]:.1f}")
            await browser.wait_for("sfrLive.store.ended", 600)
            lags = await browser.value("({poses: sfrLive.lag.poses, images: sfrLive.lag.images})")
            for name, kept in lags.items():
                print(f"image published to {name} on the screen: {spread([seconds for seconds, _ in kept])}")
            await browser.set_size(1360, 4000)
            for condition in PANELS:
                await browser.wait_for(condition)
            print(f"all {len(PANELS)} panels drawn; complaints: {browser.complaints()}")
            for kind, width, scheme in SCREENS if folder is not None else ():
                await screenshot(browser, folder / f"live-{kind}.webp", width, scheme)
            await asyncio.to_thread(replay.wait, 120)
            tables = ReportView.read((place / "out" / "report.json").read_text(), 0.0).to_plain()["tables"]
            cells = ((table["name"], cell) for table in tables for row in table["rows"] for cell in row)
            wanted = {f"{cell['key']} {name}": cell.get("text", "") for name, cell in cells if "key" in cell}
            shown = await browser.value(SHOWN)
            differ = {key: (shown.get(key), wanted[key]) for key in wanted if shown.get(key) != wanted[key]}
            print(f"{len(wanted) - len(differ)} of {len(wanted)} figures of the final report shown; others: {differ}")
    finally:
        replay.terminate()
        if replay.wait(30) not in (0, 1):
            print((place / "log").read_text()[-2000:])


async def screenshot(browser: Browser, path: Path, width: int, scheme: str) -> None:
    """Write the whole page, reduced."""
    path.parent.mkdir(parents=True, exist_ok=True)
    mobile = width < 760
    await browser.set_scheme(scheme)
    await browser.set_size(width, 900, mobile=mobile)
    await asyncio.sleep(1.0)
    height = await browser.value("document.body.scrollHeight")
    await browser.set_size(width, min(height, 5200), mobile=mobile)
    await asyncio.sleep(1.5)
    await browser.screenshot(path, scale=1.0 if mobile else 0.75)


if __name__ == "__main__":
    _, *words = sys.argv
    with tempfile.TemporaryDirectory() as name:
        asyncio.run(show_replay(Path(name), words[0] if words else "5", Path(words[1]) if words[1:] else None))
