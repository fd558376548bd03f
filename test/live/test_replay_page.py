"""The page beside a real replay: its last state is the final report, and its end matters to nobody."""

# ruff: noqa: E402 - ROS may be absent
import json
import re
import sys
import time
import urllib.request
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("aiohttp", reason="aiohttp is not installed: pip install '.[live]'")
pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.timeout(300)]
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "nodes"))

from made_scene import write_folder
from processes import Process, wait_until

from sfr_loc_map.nodes.process.live_process import live_page

COMMAND = ("-c", "from sfr_loc_map.cli.main import main; raise SystemExit(main())")


def state_of(url: str) -> dict[str, Any] | None:
    """Return the state, None where nobody serves it any more."""
    try:
        with urllib.request.urlopen(url + "state.json", timeout=10) as answer:
            return dict(json.load(answer))
    except OSError:
        return None


def test_the_last_state_is_the_final_report(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    source, out = write_folder(tmp_path / "source", 12, 3), tmp_path / "out"
    options = ("--start", "truth", "--condition", "frames=3", "--live", "--live-port", "0")
    with Process(tmp_path / "log", *COMMAND, "replay", str(source), "--out", str(out), *options) as replay:
        url = wait_until(lambda: (found := re.search(r"live: (\S+)", replay.text)) and found[1], "the address")
        last: dict[str, Any] = {}
        while (state := state_of(url)) is not None:
            last = state
            time.sleep(0.03)
        assert replay.popen.wait(120) == 0, replay.text
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
    with live_page(("--port", "0", "--host", "198.51.100.1")) as at_end:
        wait_until(lambda: "sfr live:" in capfd.readouterr().err, "what the page says of itself")
        at_end()
    assert time.monotonic() - begin < 60.0
