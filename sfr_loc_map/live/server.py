"""The server of the page: one page, its state as JSON, a websocket with figures, images and clouds, commands."""

from __future__ import annotations

import asyncio
import json
import logging
import secrets
import socket
import time
from collections.abc import Awaitable, Callable
from contextlib import suppress
from importlib.resources import files
from typing import Any

from aiohttp import WSMsgType, http_exceptions, web

from sfr_loc_map import __version__
from sfr_loc_map.errors import NodeError, SfrError
from sfr_loc_map.inputs import parse_json
from sfr_loc_map.live.access import COOKIE, HEADERS, Access
from sfr_loc_map.live.broadcast import Broadcast
from sfr_loc_map.live.client import Client
from sfr_loc_map.live.commands import Command, NoOperator, Operator
from sfr_loc_map.live.config import LiveConfig
from sfr_loc_map.live.hub import Hub
from sfr_loc_map.live.state import LiveState

KINDS = {".html": "text/html", ".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml"}
TOKEN_MARK = "@COMMAND_TOKEN@"
MAX_CLIENTS = 32
MAX_COMMAND_BYTES = 4096
MAX_MESSAGE_BYTES = 4096
SOCKET_BUFFER_BYTES = 262_144
"""Of the kernel, for each page: what waits there is older than what waits here."""
SHUTDOWN_S = 1.0
"""Time for requests under way when the server ends: a page that keeps its connection open keeps nobody."""
PERIOD_S = 0.1
"""Longest time between two looks at what is stale."""
COALESCE_S = 0.01
"""Records within this time are sent together."""


class LiveServer:
    """Shows a run. All methods but the constructor run in one event loop.

    Attributes:
        state: What is known of the run.
        url: Where the page is, once it is served.
        is_over: Whether the run has ended.
    """

    def __init__(self, config: LiveConfig, hub: Hub, operator: Operator | None = None, title: str = "") -> None:
        """Read the page.

        Args:
            config: How it is served.
            hub: Where the feed puts what it receives.
            operator: Carries commands out; None: there is nothing to command.
            title: What is shown, such as a namespace or the name of a bag.

        Raises:
            ConfigError: If other hosts are let in without a token.
        """
        self.state = LiveState()
        self.url = ""
        self.is_over = False
        self._config, self._hub, self._title = config, hub, title
        self._operator: Operator = operator or NoOperator()
        self._access = Access(config.host, config.token, secrets.token_urlsafe(18))
        self._files = _read_files(self._access.command_token)
        self._broadcast = Broadcast(self.state, hub, self._operator)
        self._begin_s = time.time()
        self._arrived = asyncio.Event()

    async def serve(self, ready: Callable[[str], None]) -> None:
        """Serve until the task is cancelled.

        Args:
            ready: Called with the address once the page can be opened.

        Raises:
            NodeError: If the port cannot be listened on.
        """
        loop = asyncio.get_running_loop()
        self._hub.on_arrival(lambda: _wake(loop, self._arrived))
        options: dict[str, Any] = {"access_log": None, "handle_signals": False, "logger": _logger()}
        runner = web.AppRunner(self.application(), shutdown_timeout=SHUTDOWN_S, **options)
        await runner.setup()
        try:
            await self._listen(runner)
            ready(self.url)
            await self._follow()
        finally:
            self._operator.close()
            await runner.cleanup()

    def end(self) -> None:
        """Tell the pages that the run is over: what is silent from now on is not missing."""
        self.is_over = True
        self._broadcast.end()

    def application(self) -> web.Application:
        """Return the routes."""
        app = web.Application(middlewares=[self._guard], client_max_size=MAX_COMMAND_BYTES)
        app.router.add_get("/", self._page)
        app.router.add_get("/healthz", self._healthz)
        app.router.add_get("/state.json", self._state_json)
        app.router.add_get("/ws", self._websocket)
        app.router.add_post("/command", self._command)
        app.router.add_get("/{name}", self._file)
        return app

    async def _listen(self, runner: web.AppRunner) -> None:
        config = self._config
        site = web.TCPSite(runner, config.host, config.port)
        try:
            await site.start()
        except OSError as error:
            place = f"{config.host} port {config.port}"
            reason = error.strerror or str(error)
            raise NodeError(f"cannot listen on {place}: {reason}; choose another --port (0: a free one)") from error
        name = f"[{config.host}]" if ":" in config.host else config.host
        port = runner.addresses[0][1]
        self.url = f"http://{name}:{port}/" + (f"?token={config.token}" if config.token else "")

    async def _follow(self) -> None:
        """Take records in and send what follows from them."""
        while True:
            with suppress(TimeoutError):
                await asyncio.wait_for(self._arrived.wait(), PERIOD_S)
            self._arrived.clear()
            for update in self._hub.take():
                if self.state.apply(update):
                    self._broadcast.note(update)
            self._broadcast.send(time.time())
            await asyncio.sleep(COALESCE_S)

    @web.middleware
    async def _guard(
        self, request: web.Request, handler: Callable[[web.Request], Awaitable[web.StreamResponse]]
    ) -> web.StreamResponse:
        refusal = self._access.refusal(request) if request.path != "/healthz" else ""
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

    async def _page(self, request: web.Request) -> web.Response:
        return self._named("index.html")

    async def _file(self, request: web.Request) -> web.Response:
        return self._named(request.match_info["name"])

    def _named(self, name: str) -> web.Response:
        if name not in self._files:
            raise web.HTTPNotFound
        kind = KINDS["." + name.rpartition(".")[2]]
        return web.Response(body=self._files[name], content_type=kind, charset="utf-8")

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
            "actions": sorted(self._operator.actions),
            "bytes_per_s": self._config.bytes_per_s,
            **self._broadcast.load(),
        }

    async def _websocket(self, request: web.Request) -> web.StreamResponse:
        if len(self._broadcast.clients) >= MAX_CLIENTS:
            raise web.HTTPServiceUnavailable
        channel = web.WebSocketResponse(heartbeat=20.0, max_msg_size=MAX_MESSAGE_BYTES, compress=False)
        await channel.prepare(request)
        transport = request.transport
        if transport is not None and (found := transport.get_extra_info("socket")) is not None:
            found.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SOCKET_BUFFER_BYTES)
        client = Client(channel, self._config.bytes_per_s)
        self._broadcast.join(client, self._server(time.time()))
        sender = asyncio.create_task(self._send(client, transport))
        try:
            async for received in channel:
                if received.type is WSMsgType.TEXT:
                    self._broadcast.receive(client, received.data)
        finally:
            self._broadcast.leave(client)
            sender.cancel()
        return channel

    async def _send(self, client: Client, transport: asyncio.Transport | None) -> None:
        """Send to a page, and close the connection of one that is cut off without waiting for it."""
        with suppress(ConnectionError):
            await client.send_all()
        if client.cut_off:
            self._broadcast.note_cut_off()
        if transport is not None:
            transport.abort()

    async def _command(self, request: web.Request) -> web.Response:
        if not self._access.may_command(request):
            return web.json_response({"ok": False, "text": "the page is of an earlier server: reload it"}, status=403)
        try:
            command = Command.parse(parse_json(await request.read()))
            text = await asyncio.to_thread(self._operator.run, command)
        except SfrError as error:
            return web.json_response({"ok": False, "text": str(error)}, status=400)
        except (ValueError, web.RequestPayloadError):
            return web.json_response({"ok": False, "text": "the command is no JSON"}, status=400)
        return web.json_response({"ok": True, "text": text})


def _logger() -> logging.Logger:
    """Return the log of the library's faults; a request that is no HTTP is answered, and nobody's traceback."""
    logger = logging.getLogger("sfr_loc_map.live")
    logger.addFilter(_is_fault)
    return logger


def _is_fault(record: logging.LogRecord) -> bool:
    error = record.exc_info[1] if record.exc_info else None
    return not isinstance(error, (http_exceptions.HttpProcessingError, web.RequestPayloadError))


def _read_files(command_token: str) -> dict[str, bytes]:
    """Return all files of the page by name; nothing else is ever served."""
    folder = files("sfr_loc_map.live") / "web"
    found = {item.name: item.read_bytes() for item in folder.iterdir() if "." + item.name.rpartition(".")[2] in KINDS}
    found["index.html"] = found["index.html"].replace(TOKEN_MARK.encode(), command_token.encode())
    return found


def _wake(loop: asyncio.AbstractEventLoop, event: asyncio.Event) -> None:
    try:
        loop.call_soon_threadsafe(event.set)
    except RuntimeError:  # the loop has ended
        return
