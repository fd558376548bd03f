"""The server of the live page: what it serves to whom, what pages are sent."""

from __future__ import annotations

import asyncio
import json
import re
import resource
import statistics
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest

from helpers.live_run import fill, frame
from sfr_loc_map.atomic import write_text
from sfr_loc_map.errors import ConfigError
from sfr_loc_map.live.commands import Action, Command
from sfr_loc_map.live.state import LiveState
from sfr_loc_map.live.updates import ImageSample

aiohttp = pytest.importorskip("aiohttp", reason="aiohttp is not installed: pip install '.[live]'")

from helpers.page_server import Recorder, served  # noqa: E402 - needs aiohttp
from sfr_loc_map.live import server  # noqa: E402 - as above
from sfr_loc_map.live.config import LiveConfig  # noqa: E402 - as above
from sfr_loc_map.live.connections import MAX_SILENT  # noqa: E402 - as above
from sfr_loc_map.live.run_end import RunEnd  # noqa: E402 - as above
from sfr_loc_map.live.server import LiveServer  # noqa: E402 - as above


class Served:
    """A server under test with a session that asks it."""

    def __init__(self, session: Any, server: LiveServer, operator: Recorder) -> None:
        self.session, self.state, self.server = session, server.state, server
        self.operator = operator
        self.port = int(server.url.split("?")[0].rsplit(":")[-1].strip("/"))

    async def get(self, path: str, **headers: str) -> tuple[int, str, Any]:
        async with self.session.get(f"http://127.0.0.1:{self.port}/{path}", headers=headers) as answer:
            return answer.status, await answer.text(), answer.headers

    async def command(self, content: Any, **headers: str) -> tuple[int, dict[str, Any]]:
        async with self.session.post(self.server.url + "command", json=content, headers=headers) as answer:
            return answer.status, json.loads(await answer.text()) if answer.content_type.endswith("json") else {}

    async def token(self) -> str:
        found = re.search(r'name="command-token" content="([^"]+)"', (await self.get(""))[1])
        assert found is not None
        return found[1]


def in_loop(test: Callable[[Served], Awaitable[None]], **config: Any) -> None:
    async def run() -> None:
        operator = Recorder()
        async with aiohttp.ClientSession() as session, served(LiveState(), "test", operator, **config) as server:
            await test(Served(session, server, operator))

    asyncio.run(asyncio.wait_for(run(), 60))


def test_nothing_but_the_page_is_served_and_commands_need_its_token() -> None:
    async def test(found: Served) -> None:
        for path in ("", "app.js", "style.css"):
            status, text, headers = await found.get(path)
            assert status == 200
            assert "default-src 'none'" in headers["Content-Security-Policy"]
            assert not re.search(r"https?://(?!www\.w3\.org)", text), "nothing is asked for elsewhere"
        for path in ("../server.py", "%2e%2e/server.py", "..%2fserver.py", "web/app.js", "etc/passwd", "%00"):
            assert (await found.get(path))[0] == 404, path
        asked = {"action": "reset", "node": "mapping_node"}
        assert (await found.get("state.json", Host=f"evil.example:{found.port}"))[0] == 403
        assert (await found.get("state.json", Origin="http://evil.example"))[0] == 403
        assert (await found.get("state.json", Host=f"localhost:{found.port}"))[0] == 200
        with pytest.raises(aiohttp.WSServerHandshakeError):
            await found.session.ws_connect(found.server.url + "ws", origin="http://evil.example")
        assert (await found.command(asked))[0] == 403
        header = {"X-SFR-Token": await found.token()}
        assert (await found.command(asked, Origin="http://evil.example", **header))[0] == 403
        assert found.operator.commands == []
        assert await found.command(asked, **header) == (200, {"ok": True, "text": "reset done"})
        assert found.operator.commands == [Command(Action.RESET, "mapping_node")]
        for bad in ({"action": "rm"}, [], {"action": "reset", "node": 1}):
            assert (await found.command(bad, **header))[0] == 400
        refused = await found.command({"action": "reset", "node": "nowhere"}, **header)
        assert refused[1]["text"] == "there is no such node"

    in_loop(test)


def test_other_hosts_need_the_token() -> None:
    for host, token in (("0.0.0.0", ""), ("0.0.0.0", "short"), ("127.0.0.1", "has\nlines")):
        with pytest.raises(ConfigError):
            LiveConfig(host=host, token=token)

    async def test(found: Served) -> None:
        for path, header, status in (
            ("state.json", {}, 403),
            ("state.json?token=wrong-word", {}, 403),
            ("state.json", {"Authorization": "Bearer a-long-secret"}, 200),
            ("?token=a-long-secret", {}, 200),
            ("healthz", {}, 200),
        ):
            assert (await found.get(path, **header))[0] == status
        for path, given in (("healthz?token=wrong-word", False), ("?token=a-long-secret", True)):
            assert ("a-long-secret" in str((await found.get(path))[2].get("Set-Cookie"))) is given

    in_loop(test, token="a-long-secret")


def test_bytes_that_are_no_request_are_refused_in_silence(capfd: pytest.CaptureFixture[str]) -> None:
    async def test(found: Served) -> None:
        body = b"POST /command HTTP/1.1\r\nX-SFR-Token: " + (await found.token()).encode()
        for request, status in (
            (b"GET / HTTP/1.1\r\nOrigin: http://[", 403),
            (b"GET / HTTP/1.1\r\nAuthorization: Bearer \xff", 200),
            (b"POST /command HTTP/1.1\r\nX-SFR-Token: \xff", 403),
            (body + b"\r\nContent-Length: 4000\r\n\r\n" + b"[" * 4000, 400),
            (body + b'\r\nContent-Length: 402\r\n\r\n{"at_s":' + b"1" * 393 + b"}", 400),
            (body + b"\r\nContent-Type: text/x; charset=none\r\nContent-Length: 2\r\n\r\n{}", 400),
            (body + b"\r\nContent-Encoding: gzip\r\nContent-Length: 2\r\n\r\n{}", 400),
            (b"GET /" + b"a" * 9000 + b" HTTP/1.1", 400),
        ):
            first, _, rest = request.partition(b"\r\n")
            reader, writer = await asyncio.open_connection("127.0.0.1", found.port)
            writer.write(first + b"\r\nHost: localhost\r\n" + rest + b"\r\n\r\n")
            head = (await asyncio.wait_for(reader.readline(), 60)).split()
            writer.close()
            assert int(head[1]) == status, request[:80]

    in_loop(test)
    assert capfd.readouterr().err == ""


def test_open_sockets_cost_nothing(capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 1000 connections that say nothing the oldest make room; a fresh client is answered at once."""
    monkeypatch.setattr(server, "IDLE_TIMEOUT_S", 2.0)
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, min(hard, 4096)), hard))

    async def test(found: Served) -> None:
        async def get_s() -> float:
            begin_s = time.monotonic()
            assert (await found.get("state.json", Connection="close"))[0] == 200
            return time.monotonic() - begin_s

        fill(found.state, 60)
        opened, took_s, alone_s = [], [], [await get_s() for _ in range(20)]
        for number in range(1000):
            reader, writer = await asyncio.open_connection("127.0.0.1", found.port)
            writer.write(b"GET /state.json HTTP/1.1\r\nHost: " if number % 2 else b"")
            opened.append((reader, writer))
            if number % 100 == 99:
                took_s.append(await get_s())
        assert statistics.median(took_s) < 0.02 + 5.0 * statistics.median(alone_s)  # a busy host answers later
        assert sorted(took_s)[-2] < 1.0
        assert max(took_s) < 5.0  # a busy host may lose one request of a connection, which is repeated after seconds
        cut = [await asyncio.wait_for(reader.read(), 20) for reader, _ in opened[: 1000 - MAX_SILENT]]
        assert set(cut) == {b""}
        await asyncio.wait_for(opened[-1][0].read(), 3 * server.IDLE_TIMEOUT_S)  # also the last ones, after a time
        for _, writer in opened:
            writer.close()

    in_loop(test)
    assert len(capfd.readouterr().err) < 500


def test_the_end_of_a_run_is_read_from_its_file_even_if_it_was_written_before_the_page_is_served(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server, "END_PERIOD_S", 0.01)
    end_file, report = tmp_path / "end.json", tmp_path / "report.html"
    write_text(json.dumps({"aborted": "mapping_node was killed by SIGKILL"}), end_file)

    async def run() -> None:
        state = LiveState()
        page = LiveServer(LiveConfig(port=0), state, Recorder())
        serving = asyncio.ensure_future(server.serve_until_signal(page, end_file=end_file))
        while not state.shown_end.aborted_by:
            await asyncio.sleep(0.01)
        assert state.shown_end.aborted_by == "mapping_node was killed by SIGKILL"
        assert state.shown_end.report_page == b""
        report.write_text("<p>report</p>")
        write_text(json.dumps({"report": str(report)}), end_file)
        while not state.shown_end.report_page:
            await asyncio.sleep(0.01)
        assert state.shown_end.report_page == b"<p>report</p>"
        serving.cancel()
        await serving

    asyncio.run(asyncio.wait_for(run(), 20))


def test_the_report_of_a_run_is_served_apart_from_the_page(tmp_path: Path) -> None:
    page = tmp_path / "report.html"
    page.write_text("<p>report</p>")

    async def test(found: Served) -> None:
        assert (await found.get("report"))[0] == 404
        found.state.end(RunEnd(report=str(page)), time.time())
        status, text, headers = await found.get("report")
        assert (status, text) == (200, "<p>report</p>")
        assert "sandbox" in headers["Content-Security-Policy"]
        assert "allow-same-origin" not in headers["Content-Security-Policy"]

    in_loop(test)


def test_a_page_gets_the_last_pose_also_if_the_path_is_thinned(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sfr_loc_map.live.path.MAX_ROWS", 4)

    async def test(found: Served) -> None:
        async with found.session.ws_connect(found.server.url + "ws") as channel:
            for number in range(12):
                for update in frame(number, 1.0):
                    await asyncio.to_thread(found.state.put, update)
            assert found.state.path.rows[-1] is not found.state.path.newest
            last = -1
            while last < 11:
                message = json.loads((await asyncio.wait_for(channel.receive(), 60)).data)
                last = message["last"]["n"] if message.get("last") else last

    in_loop(test)


def test_a_page_gets_all_that_is_known_and_then_what_changes() -> None:
    async def test(found: Served) -> None:
        fill(found.state, 10)
        async with found.session.ws_connect(found.server.url + "ws") as channel:
            texts, frames = list[dict[str, Any]](), list[bytes]()

            async def take(done: Callable[[], bool]) -> None:
                while not done():
                    message = await asyncio.wait_for(channel.receive(), 60)
                    if message.type is aiohttp.WSMsgType.TEXT:
                        texts.append(json.loads(message.data))
                    else:
                        frames.append(message.data)

            await channel.send_json({"type": "visible", "visible": True})
            await take(lambda: len(texts) >= 6 and len(frames) >= 3)
            assert [text["type"] for text in texts][:6] == ["hello", "score", "events", "live", "path", "calls"]
            assert len(texts[4]["rows"]) == 10
            assert found.state.is_watched
            for hostile in ('{"type":"visible","visible":NaN}', '{"type":"visible","visible":1e999}', "[" * 4000):
                await channel.send_str(hostile)  # the page stays connected
            rows: list[int] = []
            for number in range(10, 40):  # even while images come faster than they are taken, no figure is left out
                for update in frame(number, 1.0):
                    await asyncio.to_thread(found.state.put, update)
                found.state.put(ImageSample("loc/left", number, bytes(2000), (1, 1), (1, 1), 0.0))
            while len(rows) < 30:
                texts.clear()
                await take(lambda: any(text["type"] == "path" for text in texts))
                rows += [row["n"] for text in texts if text["type"] == "path" for row in text["rows"]]
            assert rows == list(range(10, 40))
        while found.state.is_watched:
            await asyncio.sleep(0.01)

    in_loop(test)
