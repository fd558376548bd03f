"""What a real browser shows of a replay of the sample, and how late: `make live-screen`.

python test/live/on_screen.py [RATE], a multiple of the recorded speed (5: 10 Hz)
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

ROOT = Path(__file__).resolve().parents[2]
SFR = (sys.executable, "-c", "from sfr_loc_map.cli.main import main; raise SystemExit(main())")
REPLAY = (*SFR, "replay", "sample/sample.mcap", "--start", "truth", "--live", "--live-port", "0", "--condition")
LIMITS = """
trajectory: [{condition: distance=2, position_mean_plus_3sigma_m: 0.02, heading_mean_plus_3sigma_deg: 0.1}]
map: {point_error_p95_m: 0.6}
timing: {localisation_p95_s: 0.5}
"""


async def address(log: Path) -> str:
    for _ in range(3000):
        if found := re.search(r"live: (\S+)", log.read_text(errors="replace")):
            return found[1]
        await asyncio.sleep(0.02)
    raise TimeoutError(log.read_text(errors="replace"))


async def show_replay(place: Path, rate: str) -> None:
    (place / "limits.yaml").write_text(LIMITS)
    scored = ("distance=2", "--limits", str(place / "limits.yaml"), "--out", str(place / "out"), "--rate", rate)
    begin, log = time.monotonic(), place / "log"
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    with log.open("wb") as stream:
        replay = subprocess.Popen((*REPLAY, *scored), cwd=ROOT, stdout=stream, stderr=stream, env=environment)
    try:
        async with Browser(1360, 4000) as browser:
            await browser.open(await address(log))
            await browser.wait_for("document.readyState === 'complete' && window.sfrLive")
            print(f"page up {time.monotonic() - begin:.2f} s after the command, load {os.getloadavg()[0]:.1f}")
            await browser.wait_for("sfrLive.store.ended", 600)
            lags = await browser.value("({poses: sfrLive.lag.poses, images: sfrLive.lag.images})")
            for name, kept in lags.items():
                low, high = np.quantile([seconds for seconds, _ in kept] or [np.nan], (0.5, 0.95)) * 1e3
                print(f"image published to {name} on the screen: p50 {low:.1f} ms, p95 {high:.1f} ms ({len(kept)})")
            print(f"complaints: {browser.complaints()}")
    finally:
        replay.terminate()
        if replay.wait(120) not in (0, 1):
            print(log.read_text()[-2000:])


if __name__ == "__main__":
    _, *words = sys.argv
    with tempfile.TemporaryDirectory() as name:
        asyncio.run(show_replay(Path(name), words[0] if words else "5"))
