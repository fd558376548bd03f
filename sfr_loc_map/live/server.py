"""The server of the page: one page, its state as JSON, a websocket with figures, images and clouds, commands.

Who may look on: on loopback no token is needed, but the name that the page was asked by must be one of loopback, as a
name of somebody else's may resolve to this host (DNS rebinding). Served to other hosts, each request needs the token,
as `?token=` once (a cookie keeps it) or as `Authorization: Bearer`. Who may command: whoever has the word in the page.

A page takes what is new for it when the network has room, so nothing waits here but what the state keeps anyway: all
figures in their order, of each image and cloud topic the newest. One that does not read is cut off.
"""

from __future__ import annotations

import asyncio
import hmac
import ipaddress
import json
import logging
import math
import secrets
import signal
import socket
import struct
import time
import webbrowser
from bisect import bisect_left
from collections.abc import Awaitable, Callable
from contextlib import AsyncExitStack, suppress
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from operator import attrgetter
from pathlib import Path
from typing import Any
from urllib.parse import quote, urlsplit

import numpy as np
from aiohttp import WSMsgType, http_exceptions, web

from sfr_loc_map import __version__
from sfr_loc_map.config import param
from sfr_loc_map.errors import ConfigError, NodeError, SfrError
from sfr_loc_map.geometry.arrays import FloatArray32
from sfr_loc_map.inputs import parse_json
from sfr_loc_map.live import updates
from sfr_loc_map.live.path import ROW_FIELDS
from sfr_loc_map.live.state import LiveState, ReportView
from sfr_loc_map.signals import stopping

DEFAULT_HOST, DEFAULT_PORT = "127.0.0.1", 8080
KINDS = {"html": "text/html", "css": "text/css", "js": "text/javascript", "svg": "image/svg+xml"}
TOKEN_MARK, COOKIE, COMMAND_HEADER = b"@COMMAND_TOKEN@", "sfr_live_token", "X-SFR-Token"
HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; connect-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
MIN_TOKEN, MAX_PAGES, MAX_MESSAGE_BYTES = 8, 32, 4096
SOCKET_BUFFER_BYTES = 262_144  #: Of the kernel, for each page: what waits there is older than what waits here.
SHUTDOWN_S, LAST_MESSAGE_S = 1.0, 0.1
"""Time for requests under way when the server ends (a page that keeps its connection open keeps nobody), and for the
last message to the pages."""
TICK_S = 0.01  #: What comes within it goes out as one message.
HEAD_TIMEOUT_S = 5.0  #: Of a connection, until the head of its first request is there.
MAX_WAITING, MAX_CONNECTIONS, BACKLOG, ACCEPTED = 512, 256, 2048, 128
"""Connections that have not asked for anything yet (the oldest makes room), that have, that the kernel holds, that are
taken in at once: fewer than may wait, so that one that asks is heard before those that come after it push it out."""
LOG_PERIOD_S = 60.0  #: One line of each kind of fault in this time.
REPORT_HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline' 'unsafe-eval'; img-src data: blob:; "
        "sandbox allow-scripts allow-modals allow-downloads; frame-ancestors 'none'"
    )
}
"""Of the report, which holds its own scripts: it cannot read this page."""
SEND_TIMEOUT_S = 10.0  #: A page that takes nothing for so long is cut off.
NODES_PERIOD_S = 0.25  #: At least so often the pages hear of the nodes, and by that of the server.


@dataclass(frozen=True, slots=True)
class LiveConfig:
    """How the page is served."""

    host: str = param(DEFAULT_HOST, doc="Address to listen on; another than loopback needs a token.")
    port: int = param(DEFAULT_PORT, doc="Port to listen on; 0: a free one.", low=0, high=65535)
    token: str = param("", doc="Word that each request must have; needed where other hosts are let in.")

    def __post_init__(self) -> None:
        """Check that others need a token; ConfigError if there is none, or a short one."""
        token = self.token
        if not token and not _is_loopback(self.host):
            raise ConfigError(f"'{self.host}' lets other hosts in: give --token, {MIN_TOKEN} letters or more")
        if token and (len(token) < MIN_TOKEN or not token.isascii() or not token.isprintable()):
            raise ConfigError(f"--token must have at least {MIN_TOKEN} printable ASCII letters")


class LiveServer:
    """Shows a run, at `url` once it is served. All methods but the constructor run in one event loop."""

    def __init__(self, config: LiveConfig, state: LiveState, title: str = "") -> None:
        """Read the page; the title may be a namespace or the name of a bag."""
        self.state = state
        self.url = ""
        self.pages: list[Page] = []
        self.texts = {"report": "", "events": "", "nodes": ""}  # the latest message of each, empty before the first
        self._events_version = -1
        self._config, self._title = config, title
        self._command_token = secrets.token_urlsafe(18)
        page = (files("sfr_loc_map.live") / "web").iterdir()
        self._files = {item.name: item.read_bytes() for item in page if item.name.rpartition(".")[2] in KINDS}
        self._files["index.html"] = self._files["index.html"].replace(TOKEN_MARK, self._command_token.encode())
        self._begin_s, self._nodes_s = time.time(), 0.0
        self._report: ReportView | None = None
        self._connections: web.Server | None = None
        self._waiting: dict[web.RequestHandler, asyncio.TimerHandle] = {}  # connections that have not asked yet

    async def serve(self, ready: Callable[[str], None]) -> None:
        """Serve until the task is cancelled; `ready` is called with the address once the page can be opened."""
        config, logger = self._config, logging.getLogger("sfr_loc_map.live")
        for name in (logger.name, "asyncio"):  # which tells that descriptors are used up
            logging.getLogger(name).addFilter(_Quiet())
        options: dict[str, Any] = {"access_log": None, "handle_signals": False, "logger": logger}
        app = web.Application(middlewares=[self._guard], client_max_size=MAX_MESSAGE_BYTES)
        pages = {"/healthz": self._healthz, "/state.json": self._state_json, "/ws": self._websocket}
        pages |= {"/report": self._report_page, "/{name:[^/]*}": self._file}
        app.add_routes([web.post("/command", self._command), *(web.get(*page) for page in pages.items())])
        runner = web.AppRunner(app, shutdown_timeout=SHUTDOWN_S, **options)
        await runner.setup()
        self._connections = runner.server
        loop, news = asyncio.get_running_loop(), asyncio.Event()

        def wake() -> None:
            if not news.is_set():
                with suppress(RuntimeError):  # the loop has ended
                    loop.call_soon_threadsafe(news.set)

        async with AsyncExitStack() as stack:
            stack.push_async_callback(runner.cleanup)
            try:
                listener = await loop.create_server(self._let_in, config.host, config.port, backlog=ACCEPTED)
            except OSError as error:
                place, reason = f"{config.host} port {config.port}", error.strerror or str(error)
                hint = "choose another --port (0: a free one)"
                raise NodeError(f"cannot listen on {place}: {reason}; {hint}") from error

            @stack.callback
            def end() -> None:
                if self.state.operator is not None:
                    self.state.operator.close()
                listener.close()

            for item in listener.sockets:
                with item.dup() as same:
                    same.listen(BACKLOG)
            name = f"[{config.host}]" if ":" in config.host else config.host
            query = f"?token={quote(config.token, safe='')}" if config.token else ""
            self.url = f"http://{name}:{listener.sockets[0].getsockname()[1]}/{query}"
            self.state.on_change = wake
            ready(self.url)
            while True:
                with suppress(TimeoutError):
                    async with asyncio.timeout(NODES_PERIOD_S):
                        await news.wait()
                news.clear()
                self.tell(time.time())
                await asyncio.sleep(TICK_S)

    def end(self) -> None:
        """Tell the pages that the run is over: what is silent from now on is not missing."""
        now_s = time.time()
        with self.state.lock:
            if self.state.ended_s is None:
                self.state.ended_s = now_s
        self._nodes_s = 0.0
        self.tell(now_s)

    def tell(self, now_s: float) -> None:
        """Let the pages send what has changed."""
        report = self.state.report
        if report is not None and report is not self._report:
            self._report, self.texts["report"] = report, message("report", report.to_plain())
        if not 0.0 <= now_s - self._nodes_s < NODES_PERIOD_S:
            self._nodes_s = now_s
            self.texts["nodes"] = message("nodes", self.state.live_to_plain(now_s) | {"actions": self.state.actions})
        if self._events_version != (version := self.state.timeline.version):
            self._events_version = version
            self.texts["events"] = message("events", {"events": self.state.events_to_plain()})
        for page in self.pages:
            page.news.set()

    def _let_in(self) -> web.RequestHandler:
        """Return what serves a new connection, which has some time to ask; the one that waits longest makes room."""
        assert self._connections is not None
        if len(self._waiting) >= MAX_WAITING:
            self._cut(next(iter(self._waiting)))
        handler = self._connections()
        self._waiting[handler] = asyncio.get_running_loop().call_later(HEAD_TIMEOUT_S, self._cut, handler)
        return handler

    def _cut(self, handler: web.RequestHandler) -> None:
        self._waiting.pop(handler).cancel()
        handler.force_close()

    @web.middleware
    async def _guard(
        self, request: web.Request, handler: Callable[[web.Request], Awaitable[web.StreamResponse]]
    ) -> web.StreamResponse:
        if (timer := self._waiting.pop(request.protocol, None)) is not None:
            timer.cancel()
        if self._connections and len(self._connections.connections) - len(self._waiting) > MAX_CONNECTIONS:
            request.protocol.force_close()
            return web.Response(status=503)
        refusal = self._refusal(request)
        try:
            if refusal and request.path != "/healthz":
                raise web.HTTPForbidden(reason=refusal)
            response = await handler(request)
        except web.HTTPException as error:
            response = web.Response(status=error.status, text=f"{error.reason}\n")
        if not response.prepared:
            for name, value in HEADERS.items():
                response.headers.setdefault(name, value)
            if self._config.token and request.query.get("token") and not refusal:
                response.set_cookie(COOKIE, self._config.token, httponly=True, samesite="Strict")
        return response

    def _refusal(self, request: web.Request) -> str:
        """Return why a request is refused, empty if it is not."""
        host, origin, token = request.headers.get("Host", ""), request.headers.get("Origin"), self._config.token
        if not token and not _is_loopback(_split(f"//{host}")[0]):
            return "this page is for 127.0.0.1 and localhost alone"
        if origin is not None and _split(origin)[1] != host:
            return "the request comes from another page"
        scheme, _, bearer = request.headers.get("Authorization", "").partition(" ")
        bearer = bearer if scheme.lower() == "bearer" else ""
        given = (request.query.get("token", ""), request.cookies.get(COOKIE, ""), bearer)
        if token and not any(_equal(word, token) for word in given):
            return "a token is needed: open the address that sfr live has printed"
        return ""

    async def _file(self, request: web.Request) -> web.Response:
        name = request.match_info["name"] or "index.html"
        if name not in self._files:  # nothing but the files of the page is ever served
            raise web.HTTPNotFound
        return web.Response(body=self._files[name], content_type=KINDS[name.rpartition(".")[2]], charset="utf-8")

    async def _healthz(self, request: web.Request) -> web.Response:
        return web.json_response({"status": "ok"})

    async def _state_json(self, request: web.Request) -> web.Response:
        now_s = time.time()
        content = self.state.to_plain(now_s)
        content["live"] |= {"server": self._server(now_s)}
        return web.json_response(content, dumps=lambda value: json.dumps(value, allow_nan=False))

    async def _report_page(self, request: web.Request) -> web.Response:
        if not self.state.report_page:
            raise web.HTTPNotFound
        page = self.state.report_page
        return web.Response(body=page, content_type="text/html", charset="utf-8", headers=REPORT_HEADERS)

    def _server(self, now_s: float) -> dict[str, Any]:
        uptime_s = round(now_s - self._begin_s, 3)
        facts = {"version": __version__, "title": self._title, "time_s": now_s, "uptime_s": uptime_s}
        return facts | {"actions": self.state.actions, "pages": len(self.pages)}

    async def _websocket(self, request: web.Request) -> web.StreamResponse:
        if len(self.pages) >= MAX_PAGES:
            raise web.HTTPServiceUnavailable
        channel = web.WebSocketResponse(heartbeat=20.0, max_msg_size=MAX_MESSAGE_BYTES, compress=False)
        await channel.prepare(request)
        transport = request.transport
        if transport is None:
            return channel
        transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SOCKET_BUFFER_BYTES)
        page = Page(self, channel)

        async def send() -> None:
            """Send, and close the connection of one that is cut off without waiting for it."""
            with suppress(ConnectionError, TimeoutError):
                await page.send_all(self._server(time.time()))
            transport.abort()

        self.pages.append(page)
        self.tell(time.time())
        sender = asyncio.create_task(send())
        try:
            async for received in channel:
                if received.type is WSMsgType.TEXT:
                    page.receive(received.data)
        finally:
            self.pages.remove(page)
            self.state.looks.pop(page, None)
            sender.cancel()
        return channel

    async def _command(self, request: web.Request) -> web.Response:
        if not _equal(request.headers.get(COMMAND_HEADER, ""), self._command_token):
            return web.json_response({"ok": False, "text": "the page is of an earlier server: reload it"}, status=403)
        try:
            command = updates.Command.parse(await request.read())
            text = await asyncio.to_thread(self.state.run, command)
        except (SfrError, web.RequestPayloadError) as error:
            return web.json_response({"ok": False, "text": str(error)}, status=400)
        return web.json_response({"ok": True, "text": text})


def message(kind: str, content: dict[str, Any]) -> str:
    """Return a message of figures: JSON with its kind as `type`."""
    return json.dumps({"type": kind, **content}, allow_nan=False, separators=(",", ":"))


@lru_cache(maxsize=16)
def frame_of(media: updates.Media) -> bytes:
    """Return the binary frame of an image, a cloud, a map or tracks.

    bytes 0..3     length of the header with its padding, unsigned, little endian
    bytes 4..      header: UTF-8 JSON, padded with spaces to four bytes
    the rest       image: a JPEG file; others: float32, little endian. cloud: `count` points, x y z sigma (and error,
                   where `error` is true); elevation: `rows` times `columns` cells with the layers of `names`; tracks:
                   `count` rows u v before_u before_v residual
    """
    facts: dict[str, Any]
    body: bytes | FloatArray32
    match media:
        case updates.ImageSample(jpeg=body):
            kind, facts = "image", {"size": media.size, "full_size": media.full_size}
        case updates.CloudSample(points=points, error=error):
            kind, body = "cloud", points if error is None else np.column_stack([points, error])
            facts = {"count": len(points), "total": media.total, "error": error is not None}
        case updates.ElevationSample(layers=body):
            kind, facts = "elevation", {"rows": body.shape[0], "columns": body.shape[1], "origin_m": media.origin_m}
            facts |= {"cell_m": media.cell_m, "names": media.names, "every": media.every}
        case updates.TrackSample(tracks=body):
            masks = {side: [np.round(ring, 1).tolist() for ring in rings] for side, rings in media.masks.items()}
            kind, facts = "tracks", {"count": len(body), "masks": masks}
    name = {"type": kind, "topic": media.topic, "stamp_ns": str(media.stamp_ns), "published_s": media.published_s}
    header = json.dumps(name | facts, allow_nan=False, separators=(",", ":")).encode()
    header += b" " * (-len(header) % 4)
    data = body if isinstance(body, bytes) else np.ascontiguousarray(body, "<f4").tobytes()
    return struct.pack("<I", len(header)) + header + data


class Page:
    """One page: how far it is, what it looks at. Used by the thread of the server's loop alone."""

    def __init__(self, server: LiveServer, channel: web.WebSocketResponse) -> None:
        self.news = asyncio.Event()
        self._server, self._state, self._channel = server, server.state, channel
        self._sent: dict[str, updates.Media] = {}  # of each topic the last; the topic that was sent last is the last
        self._told: dict[str, str] = {}  # of each kind of message the last
        self._pong = ""
        self._version = -1  # of the path, which changes with each restart of a player
        self._next_row = self._next_call = 0

    def receive(self, text: str) -> None:
        """Take a message of the page in: what it looks at, or a request for the server's time."""
        content: Any = None
        with suppress(ValueError):
            content = parse_json(text)
        match content:
            case {"type": "want", "views": [*views]}:
                self._state.looks[self] = frozenset(view for view in updates.View if view.value in views)
            case {"type": "ping", "sent_ms": int() | float() as sent_ms} if math.isfinite(sent_ms):
                self._pong = message("pong", {"sent_ms": sent_ms, "time_s": time.time()})
        self.news.set()

    async def send_all(self, server: dict[str, Any]) -> None:
        """Greet the page and send what is new; ConnectionError if it is gone, TimeoutError if it takes nothing."""
        await self._send(message("hello", {"server": server, "row_fields": ROW_FIELDS}))
        while True:
            self.news.clear()
            for text in self._new_figures():
                await self._send(text)
            if (media := self._new_media()) is None:
                await self.news.wait()
            else:
                self._sent.pop(media.topic, None)
                self._sent[media.topic] = media
                await self._send(frame_of(media))

    def _new_figures(self) -> list[str]:
        """Return what the page has not been sent: report, path, calls, nodes, answers."""
        state, found = self._state, {"report": self._server.texts["report"]}  # which is the first
        with state.lock:
            path, under_way, calls = state.path, state.path.under_way, list(state.calls)
            whole, self._version = path.version != self._version, path.version
            rows = path.rows[0 if whole else bisect_left(path.rows, self._next_row, key=attrgetter("n")) :]
        if whole or rows:
            self._next_row = rows[-1].n + 1 if rows else 0
            plain = [row.to_plain() for row in rows]
            found["path"] = message("path", {"whole": whole, "rows": plain, "under_way": under_way})
        calls = [call for call in calls if whole or call["n"] >= self._next_call]
        if whole or calls:
            self._next_call = calls[-1]["n"] + 1 if calls else self._next_call
            found["calls"] = message("calls", {"calls": calls, "whole": whole})
        found |= self._server.texts | {"pong": self._pong}
        new = [text for kind, text in found.items() if text != self._told.get(kind, "")]
        self._told |= found
        return new

    def _new_media(self) -> updates.Media | None:
        """Return what it looks at and has not been sent: of the topic that was sent longest ago."""
        newest, views = dict(self._state.media), self._state.looks.get(self, frozenset())
        for topic in (*(topic for topic in newest if topic not in self._sent), *self._sent):
            media = newest.get(topic)
            if media is not None and media.view in views and self._sent.get(topic) is not media:
                return media
        return None

    async def _send(self, data: str | bytes) -> None:
        send = self._channel.send_str(data) if isinstance(data, str) else self._channel.send_bytes(data)
        async with asyncio.timeout(SEND_TIMEOUT_S):
            await send


async def serve_until_signal(server: LiveServer, *, open_browser: bool = False, end_file: Path | None = None) -> None:
    """Serve until SIGINT, SIGTERM or SIGHUP; print the address when the page can be opened.

    SIGUSR1 says that the run is over: how stands in the file, as `nodes.processes.LivePage` writes it. The pages are
    told, and can be opened still.
    """

    def announce(url: str) -> None:
        print(f"live: {url}", flush=True)
        if open_browser:
            webbrowser.open(url)

    def end() -> None:
        server.end()
        loop.call_later(LAST_MESSAGE_S, task.cancel)

    def run_is_over() -> None:
        told: Any = {}
        with suppress(OSError, ValueError):
            told = {} if end_file is None else parse_json(end_file.read_text(encoding="utf-8"))
        with suppress(OSError):
            server.state.report_page = Path(told.get("report") or "").read_bytes()
        server.state.end(told.get("missing", ""), told.get("aborted", ""), time.time())
        server.end()

    task, loop = asyncio.ensure_future(server.serve(announce)), asyncio.get_running_loop()
    loop.add_signal_handler(signal.SIGUSR1, run_is_over)
    with stopping(lambda: loop.call_soon_threadsafe(end)), suppress(asyncio.CancelledError):
        await task


def _is_loopback(host: str) -> bool:
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _split(url: str) -> tuple[str, str]:
    """Return the name, and the name with the port, of an address; empty where it is none."""
    try:
        found = urlsplit(url)
        return found.hostname or "", found.netloc
    except ValueError:
        return "", ""


def _equal(given: str, wanted: str) -> bool:
    # Bytes of a header that are no UTF-8 come as halves of surrogate pairs.
    return hmac.compare_digest(given.encode(errors="surrogatepass"), wanted.encode())


class _Quiet(logging.Filter):
    """Lets one line of each kind of fault through in a time, and none of a request that is no HTTP: it is answered."""

    def __init__(self) -> None:
        super().__init__()
        self._last_s: dict[str, float] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        error = record.exc_info[1] if record.exc_info else None
        kind, now_s = str(record.msg)[:40], time.monotonic()
        if isinstance(error, http_exceptions.HttpProcessingError | web.RequestPayloadError):
            return False
        if now_s - self._last_s.get(kind, -LOG_PERIOD_S) < LOG_PERIOD_S:
            return False
        self._last_s[kind] = now_s
        return True
