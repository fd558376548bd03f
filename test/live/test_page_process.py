"""The page of running nodes and of a real replay: what is silent or lost is shown, and its end matters to nobody."""

# ruff: noqa: E402 - aiohttp may be absent
import asyncio
import json
import os
import re
import time
import urllib.request
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from signal import SIGCONT, SIGINT, SIGKILL, SIGSTOP
from typing import Any

import numpy as np
import pytest

aiohttp = pytest.importorskip("aiohttp", reason="aiohttp is not installed: pip install '.[live]'")
pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

from helpers.made_scene import LOC_RIG, write_folder
from helpers.processes import Process, node_process, nodes_of, wait_until
from helpers.score_rows import rows_about
from sfr_loc_map.io.bag.bag import Bag
from sfr_loc_map.io.image_codec import encode_png
from sfr_loc_map.live.freshness import NODE_FRESHNESS
from sfr_loc_map.suite_names import SIDES

COMMAND = ("-m", "sfr_loc_map")
PAGE = ("-m", "sfr_loc_map.nodes.start", "live.main", "--port", "0")


def asked(url: str, content: Any = None, **headers: str) -> bytes:
    data = None if content is None else json.dumps(content).encode()
    with urllib.request.urlopen(urllib.request.Request(url, data, headers), timeout=20) as answer:
        return bytes(answer.read())


def address(page: Process) -> str:
    return wait_until(lambda: (found := re.search(r"live: (\S+)", page.text)) and found[1], "the address")


def is_silent(url: str) -> bool:
    nodes = json.loads(asked(url + "state.json"))["live"]["nodes"]
    return all(node["stale"] for node in nodes if node["name"] == "monitor_node")


def bookmarks(bag: Path) -> list[str]:
    """Return the bookmarks that can be read while the recording goes on."""
    try:
        found = Bag(bag)
        topic = found.find("bookmark", "std_msgs/msg/String")
        return [] if topic is None else [message.data for _, _, message in found.messages([topic])]
    except Exception:
        return []


def test_silent_monitor_is_shown_and_comes_back_and_a_bookmark_is_recorded(tmp_path: Path) -> None:
    bag = tmp_path / "drive.mcap"
    with (
        Process(tmp_path / "page", *PAGE) as page,
        Process(tmp_path / "record", *COMMAND, "record", str(bag)) as record,
    ):
        url = address(page)
        with node_process(tmp_path, "monitor_node") as monitor:
            wait_until(lambda: not is_silent(url), "a monitor that is heard")
            begin = time.monotonic()
            monitor.popen.send_signal(SIGSTOP)
            wait_until(lambda: is_silent(url), "a monitor that is missed")
            assert (
                time.monotonic() - begin >= NODE_FRESHNESS.after_s - 1.0
            )  # since its last word, up to a second before
            monitor.popen.send_signal(SIGCONT)
            wait_until(lambda: not is_silent(url), "a monitor that is back")
            monitor.popen.kill()
            monitor.popen.wait()
        record.wait_for("recording /bookmark")
        token = re.search(rb'name="command-token" content="([^"]+)"', asked(url))
        assert token is not None
        headers = {"X-SFR-Token": token[1].decode(), "Content-Type": "application/json"}

        def marked() -> list[str]:
            asked(url + "command", {"action": "bookmark", "text": "a crater"}, **headers)
            return bookmarks(bag)

        wait_until(marked, "a bookmark in the bag")
        wait_until(lambda: is_silent(url), "a monitor that is missed for good")
        assert record.end(SIGINT) == 0, record.text
    assert set(bookmarks(bag)) == {"a crater"}


async def lost_poses(url: str) -> list[bool]:
    """Return of each pose that the page is sent whether it is lost, once the page has ended."""
    lost: dict[int, bool] = {}
    async with aiohttp.ClientSession() as session, session.ws_connect(url + "ws") as channel:
        async for received in channel:
            message = json.loads(received.data)
            if message["type"] == "path":
                lost = {} if message["whole"] else lost  # as the page does
                lost |= {row["n"]: row["lost"] for row in message["rows"]}
    return [lost[number] for number in sorted(lost)]


def test_lost_poses_are_shown_and_the_last_state_is_the_final_report(tmp_path: Path) -> None:
    source, out = write_folder(tmp_path / "source", 12, 1), tmp_path / "out"
    for side in SIDES:
        for image in sorted((source / "loc" / side).glob("*.png"))[5:8]:
            image.write_bytes(encode_png(np.zeros((LOC_RIG.height, LOC_RIG.width), np.uint8)))
    options = ("--start", "truth", "--condition", "frames=3", "--live", "--live-port", "0", "--out", str(out))
    with Process(tmp_path / "log", *COMMAND, "replay", str(source), *options) as replay, ThreadPoolExecutor(1) as pool:
        url = address(replay)
        shown, last = pool.submit(asyncio.run, lost_poses(url)), dict[str, Any]()

        def is_over() -> bool:
            last.update(json.loads(asked(url + "state.json")))
            return bool(last["live"]["has_report"])

        wait_until(is_over, "a page that is served after the run, with the report")
        page, code = asked(url + "report"), replay.end(SIGINT)
    assert code == 0, replay.text
    assert b"ocalisation and mapping report" in page
    live = last.pop("live")
    assert (live["poses"], live["ended"], live["aborted"], live["stale_reasons"]) == (12, True, None, []), replay.text
    assert shown.result() == [5 <= number < 8 for number in range(12)]
    assert last["association"]["lost"] == 3
    assert "lost" in [event["kind"] for event in live["events"]]
    assert sum(value**2 for value in live["localisation"]["error_m"]) ** 0.5 < 0.1
    report = json.loads((out / "report.json").read_text())
    assert last["association"]["matched"] == report["association"]["matched"]
    for subject in ("trajectory", "map", "timing"):
        assert rows_about(last, subject) == rows_about(report, subject)


def test_a_node_that_is_killed_aborts_the_run_and_one_that_is_stopped_makes_it_stale(tmp_path: Path) -> None:
    """The replay names the killed node, keeps the poses, and leaves no process."""
    source, out = write_folder(tmp_path / "source", 200, 0), tmp_path / "out"
    options = ("--start", "truth", "--rate", "1", "--condition", "frames=3", "--live", "--live-port", "0")
    options += ("--out", str(out))
    with Process(tmp_path / "log", *COMMAND, "replay", str(source), *options) as replay:
        url = address(replay)

        def live() -> dict[str, Any]:
            return dict(json.loads(asked(url + "state.json"))["live"])

        def node(name: str) -> int:
            children = Path(f"/proc/{replay.popen.pid}/task/{replay.popen.pid}/children").read_text().split()
            return next(int(pid) for pid in children if name in Path(f"/proc/{pid}/cmdline").read_text())

        wait_until(lambda: live()["poses"] > 10, "poses")
        os.kill(node("localisation_node"), SIGSTOP)
        stopped_s = time.monotonic()
        found = wait_until(lambda: live()["stale_reasons"], "a verdict that is not of this moment")
        assert time.monotonic() - stopped_s < 4.0  # 2 s on an idle host
        assert any("no pose" in reason or "localisation_node silent" in reason for reason in found)
        os.kill(node("localisation_node"), SIGCONT)
        wait_until(lambda: not live()["stale_reasons"], "a run that goes on")
        pids, victim = nodes_of(replay.popen.pid), node("monitor_node")
        os.kill(victim, SIGKILL)
        killed_s = time.monotonic()
        wait_until(lambda: live()["ended"], "the end")
        assert time.monotonic() - killed_s < 4.0
        assert live()["aborted"]["by"] == "monitor_node was killed by SIGKILL"
        assert abs(live()["aborted"]["at"] - time.time()) < 10.0
        assert replay.end(SIGINT) == 2, replay.text
        assert "sfr: monitor_node was killed by SIGKILL" in replay.text
        assert "Traceback" not in replay.text
    wait_until(lambda: not any(Path(f"/proc/{pid}").exists() for pid in pids), "the end of all nodes")
    assert len(pids) >= 3
    assert sorted(path.name for path in out.iterdir()) == ["estimate.csv", "stats.csv"], "no report"
