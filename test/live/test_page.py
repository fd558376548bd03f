"""The live page in a real browser: every panel is drawn, its figures are those of the state."""

from __future__ import annotations

import asyncio
import time
from dataclasses import replace

import pytest
from msgspec import structs

from helpers.browser import CHROMIUM, Browser
from helpers.live_run import NODES, STEP_NS, fill, frame, health, image
from helpers.made_scores import HOSTILE, whole_score

pytest.importorskip("aiohttp", reason="aiohttp is not installed: pip install '.[live]'")

from helpers.page_server import Recorder, served
from sfr_loc_map.inputs import NS_PER_S
from sfr_loc_map.live.server import LiveServer
from sfr_loc_map.live.state import LiveState
from sfr_loc_map.live.updates import Action, PoseSample, Report, Status, StatusKind
from sfr_loc_map.metrics.score_json import to_json

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not CHROMIUM.is_file(), reason=f"no {CHROMIUM}: install chromium to open the page"),
]
UNEXPLAINED = """[...document.querySelectorAll('button.help')]
    .filter((button) => (button.click(), !document.getElementById('tip').textContent))
    .map((button) => button.dataset.term)"""
"""Terms whose button shows no definition."""
NAMELESS = """[...document.querySelectorAll('button, select, input, canvas:not([aria-hidden])')]
    .filter((item) => !(item.textContent.trim() || item.ariaLabel || item.labels?.length)).length"""
"""How many controls a screen reader has no name for."""
FIGURES = """[...document.querySelectorAll('#figure-table td[data-key]')]
    .map((cell) => [cell.dataset.key, cell.textContent])"""
RESET = "[...document.querySelectorAll('.buttons button')].find((b) => b.textContent.startsWith('reset'))"
SWEPT = """(() => {
    const bar = document.getElementById('scrub'), box = bar.getBoundingClientRect(), told = [];
    for (let x = 0; x < box.width; x += 2) {
        bar.dispatchEvent(new PointerEvent('pointermove', {clientX: box.x + x, clientY: box.y + 4}));
        told.push(document.getElementById('tip').textContent);
    }
    return told.join();
})()"""
"""What the bar of time tells from its begin to its end."""
AHEAD_S = 300.0
SHOWN = ("headline", "verdicts", "covered", "map-covered", "readings")  #: Tables beside the path.


def text(place: str) -> str:
    return f"document.getElementById('{place}').textContent"


def data(place: str, name: str) -> str:
    return f"Number(document.getElementById('{place}').dataset.{name})"


def keep_alive(state: LiveState, ahead_s: float = 0.0) -> None:
    """Let the nodes say that they are well; what they say ahead of time is not old before, however busy the host is."""
    for node in NODES:
        state.put(health(node, time.time() + ahead_s))


async def check_panels(browser: Browser, server: LiveServer) -> None:
    """Every panel is drawn with the figures of the state, explained and named, and nothing is asked for elsewhere."""
    await browser.wait_for("document.querySelectorAll('#images canvas:not([hidden])').length === 2")
    shown = "document.querySelector('#images canvas').dataset"
    await browser.wait_for(f"{shown}.tracks === '20' && {shown}.masks === '1'")
    for layer in ("sigma", "error", "hazard", "count", "height"):
        chooser = "document.getElementById('layer')"
        await browser.value(f"{chooser}.value = '{layer}', {chooser}.dispatchEvent(new Event('change'))")
        await browser.wait_for(f"{text('map-note')}.includes('{layer} from')")
    await browser.wait_for(f"{data('map-canvas', 'cells')} > 100 && {data('cloud-canvas', 'points')} > 1000")
    await browser.wait_for(f"{data('error-canvas', 'points')} >= 3")
    for name in ("time", "transport", "receive", "memory"):
        await browser.wait_for(f"{data(f'{name}-canvas', 'points')} >= 40")
    assert await browser.value("document.querySelectorAll('#nodes .node').length") == 3
    assert "fail" in await browser.value(text("verdict"))
    bars = await browser.value("[...document.querySelectorAll('.limit')].map((row) => row.ariaLabel)")
    limits = server.state.to_plain(0.0)["live"]["limits"]
    assert len(bars) == len(limits) == len(server.state.to_plain(0.0)["verdicts"]) > 3
    assert all(limit["text"] in bar for limit, bar in zip(limits, bars, strict=True))
    assert limits[0]["text"] in (await browser.value(text("overall"))).replace("\u00a0", " "), (
        "the worst is told in the header"
    )
    assert "limit of" in await browser.value("document.getElementById('error-canvas').dataset.marks")
    figures = dict(await browser.value(FIGURES))
    tables = [t for t in server.state.to_plain(0.0)["live"]["tables"] if t["name"] in SHOWN]
    cells = (cell for table in tables for row in table["rows"] for cell in row)
    assert figures == {cell["key"]: cell["text"] for cell in cells if "key" in cell}
    assert len(figures) > 20
    assert await browser.value(UNEXPLAINED) == []
    assert await browser.value(NAMELESS) == 0
    own = (server.url, server.url.replace("http", "ws"), "blob:", "about:blank")
    assert all(url.startswith(own) for url in browser.requested())


async def check_states(browser: Browser, state: LiveState) -> None:
    """What is lost or stale is said; while it is paused what comes does not change what is shown."""
    for update in frame(81, time.time() + AHEAD_S, lost=True):
        state.put(update)
    state.put(Status("localisation_node", StatusKind.CALL, 2, "lost: few_landmarks", {}, time.time()))
    keep_alive(state)
    await browser.wait_for(f"{text('state')}.includes('lost: few_landmarks')")
    await browser.wait_for("document.querySelector('.frame.lost .badge')?.textContent === 'LOST: FEW_LANDMARKS'")
    await browser.wait_for(f"{text('nodes')}.includes('stale: silent') && {text('nodes-pill')}.includes('silent')")
    await browser.wait_for("/^○ fail, \\d+ s old$/.test(document.getElementById('verdict').textContent.trim())")
    await browser.wait_for(f"{text('overall')}.includes('_node silent for')")
    keep_alive(state, AHEAD_S)
    await browser.wait_for(f"!{text('nodes')}.includes('stale: silent')")
    await browser.wait_for(f"/^\\d+ s old$/.test({text('age')}) && !{text('verdict')}.includes('old')")
    await browser.wait_for(f"{data('timeline', 'events')} >= 3")
    await press(browser, " ")
    await browser.wait_for("!document.getElementById('live').disabled")
    await browser.value(
        "document.getElementById('pause').dispatchEvent(new PointerEvent('pointerup', {bubbles: true}))"
    )
    await press(browser, "ArrowLeft")
    await browser.wait_for("location.hash.startsWith('#t=')")
    await press(browser, "ArrowRight")
    for update in frame(82, time.time()):
        state.put(update)
    await browser.wait_for("sfrLive.store.rows.length === 82")
    assert await browser.value(data("path-canvas", "poses")) == 81
    await browser.value("document.getElementById('live').click()")
    await browser.wait_for(f"{data('path-canvas', 'poses')} === 82")


async def press(browser: Browser, key: str) -> None:
    for kind in ("keyDown", "keyUp"):
        await browser.call("Input.dispatchKeyEvent", type=kind, key=key, text=" " if key == " " else "")


async def check_address(browser: Browser) -> None:
    """View, layer and moment stand in the address and are there again after a reload; the wheel zooms."""
    await browser.value("document.getElementById('layer').value = 'sigma'")
    await browser.value("document.getElementById('layer').dispatchEvent(new Event('change'))")
    await browser.value("document.getElementById('pause').click()")
    await browser.wait_for("location.hash.includes('layer=sigma') && location.hash.includes('t=')")
    await browser.call("Page.reload")
    await browser.wait_for("sfrLive.store.rows.length > 0 && !document.getElementById('live').disabled")
    assert await browser.value("document.getElementById('layer').value") == "sigma"
    assert "not kept" in await browser.value(text("verdict"))
    await browser.value("document.getElementById('live').click()")
    await browser.wait_for("!location.hash.includes('t=')")
    box = "document.getElementById('path-canvas').getBoundingClientRect()"
    x, y = await browser.value(f"[{box}.x, {box}.y]")
    image = "document.getElementById('path-canvas').toDataURL()"
    before = await browser.value(image)
    await browser.call("Input.dispatchMouseEvent", type="mouseWheel", x=x + 60, y=y + 60, deltaX=0, deltaY=-400)
    await browser.wait_for(f"{image} !== {before!r}")


async def check_clock(browser: Browser, state: LiveState) -> None:
    """A jump of the stamps stands in the bar of time, and is told where the pointer comes to it."""
    for update in frame(83, time.time()):
        later = update.stamp_ns + 3600 * NS_PER_S
        state.put(replace(update, stamp_ns=later) if isinstance(update, PoseSample) else update)
    await browser.wait_for(f"{SWEPT}.includes('stamps go on by 3600')")


async def check_commands(browser: Browser, operator: Recorder) -> None:
    """A reset is asked for twice, a bookmark once; a page whose connection was cut gets all again."""
    await browser.wait_for(f"!{RESET}.disabled")
    await browser.value(f"{RESET}.click()")
    assert operator.commands == []
    await browser.value(f"{RESET}.click()")
    await browser.wait_for(f"{text('nodes')}.includes('reset done')")
    await browser.value("document.getElementById('bookmark').click()")
    await browser.wait_for(f"{text('bookmark')} === 'Bookmarked'")
    assert [command.action for command in operator.commands] == [Action.RESET, Action.BOOKMARK]
    await browser.value("sfrLive.connection.socket.close(), sfrLive.store.rows = []")
    await browser.wait_for("sfrLive.store.rows.length === 82")


async def check_hostile_names(browser: Browser, state: LiveState) -> None:
    """Names that are scripts stay texts."""
    score = whole_score(100, 48, 2)
    long = HOSTILE + "x" * 5000
    verdict = structs.replace(score.verdicts[0], name=HOSTILE)
    hostile = structs.replace(score, warnings=(long,), verdicts=(verdict,))
    state.put(Report(to_json(hostile), time.time()))
    state.put(
        Status("monitor_node", StatusKind.HEALTH, 2, long, {"lifecycle": long, "dropped_" + long: long}, time.time())
    )
    values = {HOSTILE: HOSTILE, "lifecycle": HOSTILE, "dropped_" + HOSTILE: HOSTILE}
    for kind in StatusKind:
        state.put(Status("localisation_node", kind, 2, HOSTILE, values, time.time()))
    state.put(image(HOSTILE, STEP_NS, time.time()))
    state.put(Report("{" + HOSTILE, time.time()))
    await browser.wait_for(
        f"document.body.textContent.includes('onerror=alert') && {text('figure-table')}.includes('onerror')"
    )
    await asyncio.sleep(0.3)
    assert await browser.value("document.querySelectorAll('script').length") == 1
    assert await browser.value("document.querySelectorAll('img[src=x]').length") == 0
    assert not [event for event in browser.events if event["method"] == "Page.javascriptDialogOpening"]
    for width in (1360, 390):
        await browser.call(
            "Emulation.setDeviceMetricsOverride", width=width, height=844, deviceScaleFactor=1, mobile=False
        )
        assert await browser.value("document.documentElement.scrollWidth <= innerWidth"), width


def test_panels_states_commands_and_hostile_names() -> None:
    async def test() -> None:
        state, operator = LiveState(), Recorder()
        state.operator = operator
        fill(state, 80)
        async with served(state, HOSTILE) as server, Browser(height=4000) as browser:
            await browser.open(server.url)
            await browser.wait_for("document.documentElement.dataset.drawn > 0")
            await check_panels(browser, server)
            await check_states(browser, state)
            await check_commands(browser, operator)
            await check_address(browser)
            await check_clock(browser, state)
            await check_hostile_names(browser, state)
            server.end()
            ended_at = f"/ended at \\d+:\\d\\d:\\d\\d/.test({text('connection')})"
            await browser.wait_for(f"{ended_at} && {text('verdict')}.includes('ended') && !{text('age')}")
            state.end("", "monitor_node was killed by SIGKILL", time.time())
            server.end()
            await browser.wait_for(f"{text('verdict')}.includes('aborted')")
            await browser.wait_for(f"{text('overall')}.startsWith('monitor_node was killed by SIGKILL at ')")
            assert browser.complaints() == []

    asyncio.run(asyncio.wait_for(test(), 280))
