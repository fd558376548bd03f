"""The live page in a real browser: every panel is drawn, its figures are those of the state."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import replace

import pytest
from browser import CHROMIUM, Browser
from live_run import NODES, STEP_NS, fill, frame, health, image
from made_scores import HOSTILE, whole_score

pytest.importorskip("aiohttp", reason="aiohttp is not installed: pip install '.[live]'")

from sfr_loc_map.live.hub import Action, Command, Hub
from sfr_loc_map.live.server import LiveConfig, LiveServer
from sfr_loc_map.live.updates import Report, Status, StatusKind
from sfr_loc_map.metrics.score_json import to_json

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not CHROMIUM.is_file(), reason=f"no {CHROMIUM}: install chromium to open the page"),
]
UNEXPLAINED = """[...document.querySelectorAll('button.help')]
    .filter((button) => (button.click(), !document.getElementById('tip').textContent))
    .map((button) => button.dataset.term)"""
"""Terms whose button shows no definition."""
NAMELESS = """[...document.querySelectorAll('button, select, input, canvas')]
    .filter((item) => !(item.textContent.trim() || item.ariaLabel || item.labels?.length)).length"""
"""How many controls a screen reader has no name for."""
FIGURES = """[...document.querySelectorAll('#figure-table td[data-key]')]
    .map((cell) => [cell.dataset.key, cell.textContent])"""
AHEAD_S = 300.0
LAYER = "document.getElementById('layer')"


class Noted:
    """Remembers what was asked."""

    actions = frozenset(Action)

    def __init__(self) -> None:
        self.commands: list[Command] = []

    def close(self) -> None:
        pass

    def run(self, command: Command) -> str:
        self.commands.append(command)
        return f"{command.action} done"


@asynccontextmanager
async def page_of(hub: Hub) -> AsyncIterator[tuple[Browser, LiveServer]]:
    ready, server = asyncio.Event(), LiveServer(LiveConfig(port=0), hub, HOSTILE)
    task = asyncio.create_task(server.serve(lambda _: ready.set()))
    await asyncio.wait_for(ready.wait(), 10)
    async with Browser(height=4000) as browser:
        await browser.open(server.url)
        await browser.wait_for("document.documentElement.dataset.drawn > 0")
        yield browser, server
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)


def in_loop(test: Callable[[], Awaitable[None]]) -> None:
    asyncio.run(asyncio.wait_for(test(), 110))


def keep_alive(hub: Hub, ahead_s: float = 0.0) -> None:
    """Let the nodes say that they are well; what they say ahead of time is not old before, however busy the host is."""
    for node in NODES:
        hub.put(health(node, time.time() + ahead_s))


def test_every_panel_is_drawn_with_the_figures_of_the_state() -> None:
    async def test() -> None:
        hub = Hub()
        fill(hub, 40)
        async with page_of(hub) as (browser, server):
            await browser.wait_for("document.querySelectorAll('#images canvas:not([hidden])').length === 2")
            shown = "document.querySelector('#images canvas').dataset"
            await browser.wait_for(f"{shown}.tracks === '20' && {shown}.masks === '1'")
            for layer in ("sigma", "error", "hazard", "count", "height"):
                await browser.value(f"{LAYER}.value = '{layer}', {LAYER}.dispatchEvent(new Event('change'))")
                await browser.wait_for(f"document.getElementById('map-note').textContent.includes('{layer} from')")
            await browser.wait_for("Number(document.getElementById('map-canvas').dataset.cells) > 100")
            await browser.wait_for("Number(document.getElementById('cloud-canvas').dataset.points) > 1000")
            for name in ("error", "time", "transport", "receive", "memory"):
                await browser.wait_for(f"document.getElementById('{name}-canvas').dataset.points >= 40")
            assert await browser.value("document.querySelectorAll('#nodes .node').length") == 3
            assert await browser.value("document.getElementById('verdict').textContent.trim()") == "✖ fail"
            shown = dict(await browser.value(FIGURES))
            (table,) = (t for t in server.state.live_to_plain(0.0)["tables"] if t["name"] == "live")
            assert shown == {cell["key"]: cell["text"] for row in table["rows"] for cell in row if "key" in cell}
            assert len(shown) > 20
            assert await browser.value(UNEXPLAINED) == []
            assert await browser.value(NAMELESS) == 0
            assert browser.complaints() == []
            own = (server.url, server.url.replace("http", "ws"), "blob:", "about:blank")
            assert all(url.startswith(own) for url in browser.requested())

    in_loop(test)


def test_hostile_names_stay_texts() -> None:
    async def test() -> None:
        hub = Hub()
        fill(hub, 3)
        score = whole_score(100, 48, 2)
        hostile = replace(score, warnings=(HOSTILE,), verdicts=(replace(score.verdicts[0], metric=HOSTILE),))
        hub.put(Report(to_json(hostile), time.time()))
        values = {HOSTILE: HOSTILE, "lifecycle": HOSTILE, "dropped_" + HOSTILE: HOSTILE}
        for kind in StatusKind:
            hub.put(Status("localisation_node", kind, 2, HOSTILE, values, time.time()))
        hub.put(image(HOSTILE, STEP_NS, time.time()))
        hub.put(Report("{" + HOSTILE, time.time()))
        async with page_of(hub) as (browser, _):
            await browser.wait_for("document.body.textContent.includes('onerror=alert')")
            await asyncio.sleep(0.3)
            assert await browser.value("document.querySelectorAll('script').length") == 1
            assert await browser.value("document.querySelectorAll('img[src=x]').length") == 0
            assert not [event for event in browser.events if event["method"] == "Page.javascriptDialogOpening"]
            assert browser.complaints() == []

    in_loop(test)


def test_lost_stale_pause_command_and_reconnection() -> None:
    async def test() -> None:
        hub = Hub()
        operator = hub.operator = Noted()
        fill(hub, 10)
        async with page_of(hub) as (browser, server):
            state = "document.getElementById('state').textContent"
            for update in frame(11, time.time() + AHEAD_S, lost=True):
                hub.put(update)
            hub.put(Status("localisation_node", StatusKind.CALL, 2, "lost: few_landmarks", {}, time.time()))
            keep_alive(hub)
            await browser.wait_for(f"{state}.includes('lost: few_landmarks')")
            await browser.wait_for("document.querySelector('.frame.lost')")
            await browser.wait_for("document.getElementById('nodes').textContent.includes('stale: silent')")
            await browser.wait_for("document.getElementById('nodes-pill').textContent.includes('silent')")
            keep_alive(hub, AHEAD_S)
            await browser.wait_for("!document.getElementById('nodes').textContent.includes('stale: silent')")
            # pause: what comes does not change what is shown
            await browser.value("document.getElementById('pause').click()")
            await browser.wait_for("!document.getElementById('live').disabled")
            for update in frame(12, time.time()):
                hub.put(update)
            await browser.wait_for("sfrLive.store.rows.length === 12")
            assert await browser.value("document.getElementById('path-canvas').dataset.poses") == "11"
            await browser.value("document.getElementById('live').click()")
            await browser.wait_for("document.getElementById('path-canvas').dataset.poses === '12'")
            button = "[...document.querySelectorAll('.buttons button')].find((b) => b.textContent.startsWith('reset'))"
            await browser.wait_for(f"!{button}.disabled")
            await browser.value(f"{button}.click()")
            assert operator.commands == []
            await browser.value(f"{button}.click()")
            await browser.wait_for("document.getElementById('nodes').textContent.includes('reset done')")
            await browser.value("document.getElementById('bookmark').click()")
            await browser.wait_for("document.getElementById('bookmark').textContent === 'Bookmarked'")
            assert [command.action for command in operator.commands] == [Action.RESET, Action.BOOKMARK]
            # the connection is cut: the page gets all again
            await browser.value("sfrLive.connection.socket.close(), sfrLive.store.rows.length = 0")
            await browser.wait_for("sfrLive.store.rows.length === 12")
            server.end()
            await browser.wait_for("document.getElementById('connection').textContent.includes('ended')")
            assert browser.complaints() == []
            json.dumps(browser.events)

    in_loop(test)
