"""The page beside a real replay: its last state is the final report, and its end matters to nobody."""

# ruff: noqa: E402 - ROS may be absent
import asyncio
import json
import re
import sys
import time
import urllib.request
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
aiohttp = pytest.importorskip("aiohttp", reason="aiohttp is not installed: pip install '.[live]'")
pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.timeout(300)]
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "nodes"))

from made_scene import LOC_RIG, write_folder
from processes import Process, wait_until

from sfr_loc_map.inputs import SIDES
from sfr_loc_map.io.image_codec import encode_png
from sfr_loc_map.live.path import ROW_FIELDS
from sfr_loc_map.nodes.processes import LivePage

COMMAND = ("-c", "from sfr_loc_map.cli.main import main; raise SystemExit(main())")


def state_of(url: str) -> dict[str, Any] | None:
    """Return the state, None where nobody serves it any more."""
    try:
        with urllib.request.urlopen(url + "state.json", timeout=10) as answer:
            return dict(json.load(answer))
    except OSError:
        return None


async def lost_poses(url: str) -> list[bool]:
    """Return of each pose that the page is sent whether it is lost, once the page has ended."""
    lost: dict[int, bool] = {}
    async with aiohttp.ClientSession() as session, session.ws_connect(url + "ws") as channel:
        async for received in channel:
            message = json.loads(received.data)
            if message["type"] == "path":
                lost = {} if message["whole"] else lost  # as the page does
                lost |= {row[ROW_FIELDS.index("n")]: bool(row[ROW_FIELDS.index("lost")]) for row in message["rows"]}
    return [lost[number] for number in sorted(lost)]


def test_lost_poses_are_shown_and_the_last_state_is_the_final_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    source, out = write_folder(tmp_path / "source", 12, 1), tmp_path / "out"
    for side in SIDES:
        for image in sorted((source / "loc" / side).glob("*.png"))[5:8]:
            image.write_bytes(encode_png(np.zeros((LOC_RIG.height, LOC_RIG.width), np.uint8)))
    options = ("--start", "truth", "--condition", "frames=3", "--live", "--live-port", "0")
    with (
        Process(tmp_path / "log", *COMMAND, "replay", str(source), "--out", str(out), *options) as replay,
        ThreadPoolExecutor(1) as pool,
    ):
        url = wait_until(lambda: (found := re.search(r"live: (\S+)", replay.text)) and found[1], "the address")
        shown = pool.submit(asyncio.run, lost_poses(url))
        last: dict[str, Any] = {}
        while (state := state_of(url)) is not None:
            last = state
            time.sleep(0.03)
        assert replay.popen.wait(120) == 0, replay.text
    assert shown.result() == [5 <= number < 8 for number in range(12)]
    assert last["trajectory"]["lost"] == 3
    live = last.pop("live")
    assert live["poses"] == 12
    assert live["overall"]["state"] == "no verdict"
    assert last == json.loads((out / "monitor.json").read_text())
    report = json.loads((out / "report.json").read_text())
    for part in ("position_m", "attitude_deg", "heading_deg", "count", "matched"):
        assert last["trajectory"][part] == report["trajectory"][part]
    assert last["map"] == report["map"]
    assert last["timing"] == report["timing"]
    row = live["localisation"]
    assert row["error_m"] is not None
    assert sum(value**2 for value in row["error_m"]) ** 0.5 < 0.1


def test_a_page_that_cannot_start_or_is_killed_stops_nobody(capfd: pytest.CaptureFixture[str]) -> None:
    begin = time.monotonic()
    with LivePage(("--port", "0", "--host", "198.51.100.1")) as page:
        wait_until(lambda: "sfr live:" in capfd.readouterr().err, "what the page says of itself")
        page.run_is_over()
    assert time.monotonic() - begin < 60.0
