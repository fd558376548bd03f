"""The page of running nodes: one that hangs, goes on and is killed; a bookmark in the bag of a running `sfr record`."""

# ruff: noqa: E402 - ROS may be absent
from __future__ import annotations

import json
import re
import sys
import urllib.request
from pathlib import Path
from signal import SIGCONT, SIGINT, SIGSTOP
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("aiohttp", reason="aiohttp is not installed: pip install '.[live]'")
pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.timeout(300)]
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "nodes"))

from processes import Process, node_process, wait_until

from sfr_loc_map.io.bag import Bag
from sfr_loc_map.live.state import STALE_AFTER_S
from sfr_loc_map.nodes import environment

PAGE = ("-m", "sfr_loc_map.nodes.start", "nodes.live_page", "--port", "0")
RECORD = ("-c", "from sfr_loc_map.cli.main import main; raise SystemExit(main())", "record")


@pytest.fixture(autouse=True)
def own_domain(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(environment.free_domain()))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "ros_log"))
    monkeypatch.setenv(environment.PROFILE_VARIABLE, str(environment.PROFILE))


def asked(url: str, content: Any = None, **headers: str) -> bytes:
    data = None if content is None else json.dumps(content).encode()
    with urllib.request.urlopen(urllib.request.Request(url, data, headers), timeout=20) as answer:
        return bytes(answer.read())


def monitor_of(url: str) -> dict[str, Any]:
    nodes = json.loads(asked(url + "state.json"))["live"]["nodes"]
    return next((node for node in nodes if node["name"] == "monitor_node"), {"stale": True, "age_s": None})


def bookmarks(bag: Path) -> list[str]:
    """Return the bookmarks that can be read while the recording goes on."""
    if not list(bag.glob("*.mcap")):
        return []
    try:
        found = Bag(bag)
        topic = found.find("bookmark", "std_msgs/msg/String")
        return [] if topic is None else [message.data for _, _, message in found.messages([topic])]
    except Exception:
        return []


def test_silent_monitor_is_shown_and_comes_back_and_a_bookmark_is_recorded(tmp_path: Path) -> None:
    bag = tmp_path / "drive.mcap"
    with Process(tmp_path / "page", *PAGE) as page, Process(tmp_path / "record", *RECORD, str(bag)) as record:
        url = wait_until(lambda: (found := re.search(r"live: (\S+)", page.text)) and found[1], "the address")
        with node_process(tmp_path, "monitor_node") as monitor:
            wait_until(lambda: not monitor_of(url)["stale"], "a monitor that is heard")
            monitor.popen.send_signal(SIGSTOP)
            silent = wait_until(lambda: (node := monitor_of(url))["stale"] and node, "a monitor that is missed")
            assert silent["age_s"] >= STALE_AFTER_S
            monitor.popen.send_signal(SIGCONT)
            wait_until(lambda: not monitor_of(url)["stale"], "a monitor that is back")
            monitor.popen.kill()
            monitor.popen.wait()
            wait_until(lambda: monitor_of(url)["stale"], "a monitor that is missed for good")
        record.wait_for("records /bookmark")
        token = re.search(rb'name="command-token" content="([^"]+)"', asked(url))
        assert token is not None
        headers = {"X-SFR-Token": token[1].decode(), "Content-Type": "application/json"}

        def marked() -> list[str]:
            asked(url + "command", {"action": "bookmark", "text": "a crater"}, **headers)
            return bookmarks(bag)

        wait_until(marked, "a bookmark in the bag")
        assert record.end(SIGINT) == 0, record.text
    assert set(bookmarks(bag)) == {"a crater"}
