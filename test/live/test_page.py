"""The live page in a real browser: every panel is drawn, its figures are those of the state."""

from __future__ import annotations

import asyncio
import time
from dataclasses import replace

import pytest
from msgspec import structs

from helpers.browser import CHROMIUM, Browser
from helpers.live_run import NODES, call, fill, frame, health
from helpers.made_scores import HOSTILE, whole_score

pytest.importorskip("aiohttp", reason="aiohttp is not installed: pip install '.[live]'")

from helpers.page_server import Recorder, served
from sfr_loc_map.live.commands import Action
from sfr_loc_map.live.run_end import RunEnd
from sfr_loc_map.live.server import LiveServer
from sfr_loc_map.live.state import LiveState
from sfr_loc_map.live.updates import ImageProblem, PoseSample, PublishedScore, Status
from sfr_loc_map.live.values import state_json
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.message_types import Level, StatusKind
from sfr_loc_map.metrics.judging.judge import judged_by
from sfr_loc_map.metrics.judging.limits_file import parse_limits
from sfr_loc_map.metrics.stored.score_json import to_json

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not CHROMIUM.is_file(), reason=f"no {CHROMIUM}: install chromium to open the page"),
]
UNEXPLAINED = """[...document.querySelectorAll('button.help')]
    .filter((button) => (button.click(), !document.getElementById('tip').textContent))
    .map((button) => button.dataset.term)"""
"""Terms whose button shows no definition."""
NAMELESS = """[...document.querySelectorAll('button, select, [role=img], img:not([hidden])')]
    .filter((item) => !(item.textContent.trim() || item.ariaLabel || item.alt || item.labels?.length)).length"""
"""How many controls a screen reader has no name for."""
FIGURES = """[...document.querySelectorAll('#figure-table td[data-key]')]
    .map((cell) => [cell.dataset.key, cell.textContent])"""
RESET = "[...document.querySelectorAll('.buttons button')].find((b) => b.textContent.startsWith('reset'))"
AHEAD_S = 300.0
SHOWN = ("headline", "verdicts")  #: Tables that are not folded.


def text(place: str) -> str:
    return f"document.getElementById('{place}').textContent"


def values(plot: str) -> str:
    """Count of values that a plot shows."""
    return f"Number(document.getElementById('{plot}-plot').dataset.values)"


def traces(plot: str, field: str) -> str:
    """A field of each trace, as plotly.js has drawn it."""
    return f"document.getElementById('{plot}-plot').data.map((trace) => trace.{field})"


def keep_alive(state: LiveState, ahead_s: float = 0.0) -> None:
    """Let the nodes say that they are well; what they say ahead of time is not old before, however busy the host is."""
    for node in NODES:
        state.put(health(node, time.time() + ahead_s))


async def choose(browser: Browser, place: str, value: str) -> None:
    chooser = f"document.getElementById('{place}')"
    await browser.value(f"{chooser}.value = '{value}', {chooser}.dispatchEvent(new Event('change'))")


async def check_panels(browser: Browser, server: LiveServer) -> None:
    """Every panel is drawn with the figures of the state, explained and named, and nothing is asked for elsewhere."""
    live = state_json(server.state, 0.0)["live"]
    await browser.wait_for("document.querySelectorAll('#images img[src]:not([hidden])').length === 2")
    await browser.wait_for("[...document.querySelectorAll('#images img')].every((image) => image.naturalWidth === 320)")
    await browser.wait_for(f"{text('images')}.includes('20 tracks')")
    titles = {"sigma": "sigma, m", "hazard": "hazard, %", "count": "points in a cell", "height": "height, m"}
    for layer, title in titles.items():
        await choose(browser, "layer", layer)
        await browser.wait_for(f"{traces('map', 'colorbar.title.text')}[0] === '{title}'")
    await browser.wait_for(f"{values('map')} > 100 && {text('map-note')}.includes('cells of')")
    await browser.wait_for(f"{values('errors')} >= 3 && {traces('errors', 'name')}.some((n) => n.startsWith('limit '))")
    await browser.wait_for(f"{values('time')} >= 120 && {values('memory')} >= 40 && {values('events')} >= 2")
    assert set(await browser.value(traces("path", "name"))) > {"estimate", "truth", "last pose"}
    assert await browser.value("document.querySelectorAll('#nodes .node').length") == 3
    assert live["overall"]["state"] in await browser.value(text("verdict"))
    bars = await browser.value(traces("limits", "hovertext") + "[0]")
    assert len(bars) == len(live["limits"]) == len(state_json(server.state, 0.0)["verdicts"]) > 3
    assert all(limit["text"] in bar for limit, bar in zip(live["limits"], bars, strict=True))
    shares = await browser.value(traces("limits", "x") + "[0]")
    assert shares == pytest.approx([min(limit["share"] or 0.0, 1.5) for limit in live["limits"]])
    assert live["limits"][0]["text"] in await browser.value(text("overall")), "the header names the worst"
    figures = dict(await browser.value(FIGURES))
    cells = [cell for table in live["tables"] if table["name"] in SHOWN for row in table["rows"] for cell in row]
    sent = {cell["key"]: cell["text"] for cell in cells if "key" in cell}
    shown = {key: text.split(" ", 1)[1] if key.endswith(".verdict") else text for key, text in figures.items()}
    assert shown == sent, "a verdict has an icon before its word"
    assert len(figures) > 20
    assert await browser.value(UNEXPLAINED) == []
    assert await browser.value(NAMELESS) == 0
    own = (server.url, server.url.replace("http", "ws"), "blob:", "data:image/png", "about:blank")
    assert all(url.startswith(own) for url in browser.requested())


async def check_states(browser: Browser, state: LiveState) -> None:
    """What is lost, stale or cannot be shown is reported."""
    look = "document.getElementById('state').className"
    state.put(call(79, time.time(), "lost", "diverged"))
    await browser.wait_for(f"{text('state')}.includes('lost: diverged') && {look} === 'pill fail'")
    await browser.wait_for("document.querySelector('.frame.lost .badge')?.textContent === 'LOST: DIVERGED'")
    state.put(call(79, time.time(), ""))
    await browser.wait_for(f"{text('state')}.includes('state unknown') && {look} === 'pill open'")
    for update in frame(81, time.time() + AHEAD_S, lost=True):
        state.put(update)
    state.put(call(81, time.time(), "lost", "few_landmarks"))
    keep_alive(state)
    await browser.wait_for(f"{text('state')}.includes('lost: few_landmarks')")
    await browser.wait_for("document.querySelector('.frame.lost .badge')?.textContent === 'LOST: FEW_LANDMARKS'")
    await browser.wait_for(f"{traces('events', 'name')}.includes('lost')")
    await browser.wait_for(f"{text('nodes')}.includes('stale: silent') && {text('nodes-pill')}.includes('silent')")
    verdict = state_json(state, 0.0)["live"]["overall"]["state"]
    await browser.wait_for(f"{text('verdict')}.trim() === '○ {verdict}' && /^\\d+ s old$/.test({text('age')})")
    await browser.wait_for(f"{text('overall')}.includes('_node silent for')")
    keep_alive(state, AHEAD_S)
    await browser.wait_for(f"!{text('nodes')}.includes('stale: silent')")
    await browser.wait_for(f"/^\\d+ s old$/.test({text('age')}) && !{text('verdict')}.includes('○')")
    state.put(ImageProblem("loc/left", "encoding 'yuv' is unknown"))
    await browser.wait_for(f"{text('images')}.includes(\"encoding 'yuv' is unknown\")")
    state.put(ImageProblem("nav/left", "no publisher of nav/left"))
    await choose(browser, "rig", "nav")
    await browser.wait_for(f"{text('images')}.includes('no publisher of nav/left')")
    await choose(browser, "rig", "loc")


async def check_clock(browser: Browser, state: LiveState) -> None:
    """A jump of the stamps is an event once three poses agree on it."""
    for update in (update for number in (83, 84, 85) for update in frame(number, time.time())):
        later = update.stamp_ns + 3600 * NS_PER_S
        state.put(replace(update, stamp_ns=later) if isinstance(update, PoseSample) else update)
    await browser.wait_for(f"{traces('events', 'hovertext')}.flat().join().includes('stamps jump forward by 3600')")


async def check_commands(browser: Browser, operator: Recorder) -> None:
    """A reset is asked for twice, a bookmark once; a page whose connection was cut gets all again, and nothing else."""
    await browser.wait_for(f"!{RESET}.disabled")
    await browser.value(f"{RESET}.click()")
    assert operator.commands == []
    await browser.value(f"{RESET}.click()")
    await browser.wait_for(f"{text('nodes')}.includes('reset done')")
    await browser.value("document.getElementById('bookmark').click()")
    await browser.wait_for(f"{text('bookmark')} === 'Bookmarked'")
    assert [command.action for command in operator.commands] == [Action.RESET, Action.BOOKMARK]
    earlier = "sfrLive.run.images.set('of an earlier run', null)"
    await browser.value(f"sfrLive.connection.socket.close(), {earlier}, sfrLive.run.keptPoses = []")
    await browser.wait_for("sfrLive.run.poses.length === 81")
    assert not await browser.value("sfrLive.run.images.has('of an earlier run')")


async def check_hostile_names(browser: Browser, state: LiveState) -> None:
    """Names that are scripts stay texts."""
    long = HOSTILE + "x" * 5000
    limits = parse_limits({"memory": {"localisation_peak_bytes": {"limit": 2e9, "id": HOSTILE, "text": HOSTILE}}}, "")
    hostile = judged_by(structs.replace(whole_score(100, 48, 2), warnings=(long,)), limits)
    state.put(PublishedScore(to_json(hostile), time.time()))
    state.put(
        Status(
            "monitor_node",
            StatusKind.HEALTH,
            Level.ERROR,
            long,
            {"lifecycle": long, "dropped_" + long: long},
            time.time(),
        )
    )
    values = {HOSTILE: HOSTILE, "lifecycle": HOSTILE, "dropped_" + HOSTILE: HOSTILE}
    for kind in StatusKind:
        state.put(Status("localisation_node", kind, Level.ERROR, HOSTILE, values, time.time()))
    state.put(call(82, time.time(), "degraded", HOSTILE))
    state.put(ImageProblem("loc/left", HOSTILE))
    state.put(PublishedScore("{" + HOSTILE, time.time()))
    await browser.wait_for(
        f"document.body.textContent.includes('onerror=alert') && {text('figure-table')}.includes('onerror')"
    )
    await asyncio.sleep(0.3)
    assert await browser.value("document.querySelectorAll('script').length") == 2
    assert await browser.value("document.querySelectorAll('img[src=x]').length") == 0
    assert not [event for event in browser.events if event["method"] == "Page.javascriptDialogOpening"]
    links = "[...document.querySelectorAll('.plot a, #limits-plot a')].length"
    assert await browser.value(links) == 0, "a name is not markup of plotly.js either"
    for width in (1360, 390):
        await browser.call(
            "Emulation.setDeviceMetricsOverride", width=width, height=844, deviceScaleFactor=1, mobile=False
        )
        assert await browser.value("document.documentElement.scrollWidth <= innerWidth"), width


def test_panels_states_commands_and_hostile_names() -> None:
    async def test() -> None:
        state, operator = LiveState(), Recorder()
        fill(state, 80)
        async with served(state, HOSTILE, operator) as server, Browser(height=4000) as browser:
            await browser.open(server.url)
            await browser.wait_for("document.documentElement.dataset.poses > 0")
            await check_panels(browser, server)
            await check_states(browser, state)
            await check_commands(browser, operator)
            await check_clock(browser, state)
            await check_hostile_names(browser, state)
            server.show_end()
            ended_at = f"/ended \\d{{4}}-\\d\\d-\\d\\d \\d\\d:\\d\\d:\\d\\d/.test({text('connection')})"
            await browser.wait_for(f"{ended_at} && {text('verdict')}.includes('ended') && !{text('age')}")
            await browser.value("document.getElementById('cameras').scrollIntoView()")
            await browser.wait_for(f"!{text('images')}.includes('onerror')")  # no image is missing after the end
            server.show_end(RunEnd(aborted="monitor_node was killed by SIGKILL"))
            await browser.wait_for(f"{text('verdict')}.includes('aborted')")
            await browser.wait_for(f"{text('overall')}.startsWith('monitor_node was killed by SIGKILL at ')")
            assert browser.complaints() == []

    asyncio.run(asyncio.wait_for(test(), 280))
