"""The server of the page: one page, its state as JSON, a websocket with figures, images and clouds, commands.

Who may look on: on loopback no token is needed, but the name that the page was asked by must be one of loopback, as a
name of somebody else's may resolve to this host (DNS rebinding). Served to other hosts, each request needs the token,
as `?token=` once (a cookie keeps it) or as `Authorization: Bearer`. Who may command: whoever has the word in the page.
"""

from __future__ import annotations

import asyncio
import gc
import hmac
import ipaddress
import json
import logging
import secrets
import signal
import socket
import time
import webbrowser
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass
from importlib.resources import files
from typing import Any
from urllib.parse import urlsplit

from aiohttp import WSMsgType, http_exceptions, web

from sfr_loc_map import __version__
from sfr_loc_map.config import param
from sfr_loc_map.errors import ConfigError, NodeError, SfrError
from sfr_loc_map.inputs import parse_json
from sfr_loc_map.live.hub import Command, Hub
from sfr_loc_map.live.pages import Page, Pages
from sfr_loc_map.live.state import LiveState

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
SOCKET_BUFFER_BYTES = 262_144
"""Of the kernel, for each page: what waits there is older than what waits here."""
SHUTDOWN_S, LAST_MESSAGE_S = 1.0, 0.1
"""Time for requests under way when the server ends (a page that keeps its connection open keeps nobody), and for the
last message to the pages."""
TICK_S, PERIOD_S = 0.01, 0.1
"""Time between two looks at what has come, longest time between two looks at what is stale."""


@dataclass(frozen=True, slots=True)
class LiveConfig:
    """How the page is served."""

    host: str = param(DEFAULT_HOST, doc="Address to listen on; another than loopback needs a token.")
    port: int = param(DEFAULT_PORT, doc="Port to listen on; 0: a free one.", low=0, high=65535)
    token: str = param("", doc="Word that each request must have; needed where other hosts are let in.")
    bytes_per_s: float = param(2e6, unit="B/s", doc="Budget of images and clouds for each page.", low=1e4, high=1e9)

    def __post_init__(self) -> None:
        """Check that others need a token; ConfigError if there is none, or a short one."""
        token = self.token
        if not token and not _is_loopback(self.host):
            raise ConfigError(f"'{self.host}' lets other hosts in: give --token, {MIN_TOKEN} letters or more")
        if token and (len(token) < MIN_TOKEN or not token.isascii() or not token.isprintable()):
            raise ConfigError(f"--token must have at least {MIN_TOKEN} printable ASCII letters")


class LiveServer:
    """Shows a run, at `url` once it is served. All methods but the constructor run in one event loop."""

    def __init__(self, config: LiveConfig, hub: Hub, title: str = "") -> None:
        """Read the page; the title may be a namespace or the name of a bag."""
        self.state = LiveState()
        self.url = ""
        self._config, self._hub, self._title = config, hub, title
        self._command_token = secrets.token_urlsafe(18)
        page = (files("sfr_loc_map.live") / "web").iterdir()
        self._files = {item.name: item.read_bytes() for item in page if item.name.rpartition(".")[2] in KINDS}
        self._files["index.html"] = self._files["index.html"].replace(TOKEN_MARK, self._command_token.encode())
        self._pages = Pages(self.state, hub)
        self._begin_s = time.time()

    async def serve(self, ready: Callable[[str], None]) -> None:
        """Serve until the task is cancelled; `ready` is called with the address once the page can be opened.

        Raises:
            NodeError: If the port cannot be listened on.
        """
        config, logger = self._config, logging.getLogger("sfr_loc_map.live")
        logger.addFilter(_is_fault)
        options: dict[str, Any] = {"access_log": None, "handle_signals": False, "logger": logger}
        app = web.Application(middlewares=[self._guard], client_max_size=MAX_MESSAGE_BYTES)
        routes = {"/healthz": self._healthz, "/state.json": self._state_json, "/ws": self._websocket}
        app.add_routes([web.get(path, handler) for path, handler in routes.items()])
        app.add_routes([web.post("/command", self._command), web.get("/{name:[^/]*}", self._file)])
        runner = web.AppRunner(app, shutdown_timeout=SHUTDOWN_S, **options)
        await runner.setup()
        try:
            try:
                await web.TCPSite(runner, config.host, config.port).start()
            except OSError as error:
                place, reason = f"{config.host} port {config.port}", error.strerror or str(error)
                hint = "choose another --port (0: a free one)"
                raise NodeError(f"cannot listen on {place}: {reason}; {hint}") from error
            name = f"[{config.host}]" if ":" in config.host else config.host
            query = f"?token={config.token}" if config.token else ""
            self.url = f"http://{name}:{runner.addresses[0][1]}/{query}"
            ready(self.url)
            told_s = 0.0
            while True:
                updates, now_s = self._hub.take(), time.time()
                for update in updates:
                    if self.state.apply(update):
                        self._pages.note(update)
                if updates or not 0.0 <= now_s - told_s < PERIOD_S:
                    told_s = now_s
                    self._pages.tell(now_s)
                await asyncio.sleep(TICK_S)
        finally:
            if self._hub.operator is not None:
                self._hub.operator.close()
            await runner.cleanup()

    def end(self) -> None:
        """Tell the pages that the run is over: what is silent from now on is not missing."""
        self._pages.is_over = True
        self._pages.tell(time.time())

    @web.middleware
    async def _guard(
        self, request: web.Request, handler: Callable[[web.Request], Awaitable[web.StreamResponse]]
    ) -> web.StreamResponse:
        refusal = self._refusal(request) if request.path != "/healthz" else ""
        if refusal:
            return web.Response(status=403, text=refusal + "\n", headers=HEADERS)
        try:
            response = await handler(request)
        except web.HTTPException as error:
            return web.Response(status=error.status, text=f"{error.reason}\n", headers=HEADERS)
        if not response.prepared:
            response.headers.update(HEADERS)
            if self._config.token and request.query.get("token"):
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
        given = (request.query.get("token", ""), request.cookies.get(COOKIE, ""), bearer if scheme == "Bearer" else "")
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

    def _server(self, now_s: float) -> dict[str, Any]:
        """Return what is to be told of the server itself."""
        return {
            "version": __version__,
            "title": self._title,
            "time_s": now_s,
            "uptime_s": round(now_s - self._begin_s, 3),
            "actions": self._hub.actions,
            "bytes_per_s": self._config.bytes_per_s,
            **self._pages.load(),
        }

    async def _websocket(self, request: web.Request) -> web.StreamResponse:
        if len(self._pages.pages) >= MAX_PAGES:
            raise web.HTTPServiceUnavailable
        channel = web.WebSocketResponse(heartbeat=20.0, max_msg_size=MAX_MESSAGE_BYTES, compress=False)
        await channel.prepare(request)
        transport = request.transport
        if transport is None:
            return channel
        transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SOCKET_BUFFER_BYTES)
        page = Page(self._pages, channel, self._config.bytes_per_s, transport.get_write_buffer_size)
        self._pages.join(page)

        async def send() -> None:
            """Send, and close the connection of one that is cut off without waiting for it."""
            with suppress(ConnectionError):
                await page.send_all(self._server(time.time()))
            transport.abort()

        sender = asyncio.create_task(send())
        try:
            async for received in channel:
                if received.type is WSMsgType.TEXT:
                    self._pages.receive(page, received.data)
        finally:
            self._pages.leave(page)
            sender.cancel()
        return channel

    async def _command(self, request: web.Request) -> web.Response:
        if not _equal(request.headers.get(COMMAND_HEADER, ""), self._command_token):
            return web.json_response({"ok": False, "text": "the page is of an earlier server: reload it"}, status=403)
        try:
            command = Command.parse(parse_json(await request.read()))
            text = await asyncio.to_thread(self._hub.run, command)
        except SfrError as error:
            return web.json_response({"ok": False, "text": str(error)}, status=400)
        except (ValueError, web.RequestPayloadError):
            return web.json_response({"ok": False, "text": "the command is no JSON"}, status=400)
        return web.json_response({"ok": True, "text": text})


async def serve_until_signal(server: LiveServer, *, open_browser: bool = False) -> None:
    """Serve until SIGINT or SIGTERM; print the address when the page can be opened.

    SIGUSR1 says that the run is over: the pages are told, and can be opened still.
    """
    gc.collect()
    gc.freeze()  # what is imported stays: cycles of pages that have gone are then found soon

    def announce(url: str) -> None:
        print(f"live: {url}", flush=True)
        if open_browser:
            webbrowser.open(url)

    def end() -> None:
        server.end()
        loop.call_later(LAST_MESSAGE_S, task.cancel)

    task, loop = asyncio.ensure_future(server.serve(announce)), asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, end)
    loop.add_signal_handler(signal.SIGUSR1, server.end)
    with suppress(asyncio.CancelledError):
        await task


def _is_loopback(host: str) -> bool:
    """Tell whether a host can be reached from this machine alone."""
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


def _is_fault(record: logging.LogRecord) -> bool:
    """Tell the library's faults from requests that are no HTTP, which are answered, and nobody's traceback."""
    error = record.exc_info[1] if record.exc_info else None
    return not isinstance(error, http_exceptions.HttpProcessingError | web.RequestPayloadError)
