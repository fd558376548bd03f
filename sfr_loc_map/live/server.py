"""The server of the live page: its files, the state as JSON, a websocket for each open page, commands.

Each request requires access (`access`), except for `/healthz`. A command also requires the command token, which is part
of the served page.
"""

from __future__ import annotations

import asyncio
import json
import logging
import secrets
import time
import webbrowser
from collections.abc import Awaitable, Callable
from contextlib import closing, suppress
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

from aiohttp import WSMsgType, http_exceptions, web

from sfr_loc_map import __version__
from sfr_loc_map.errors import NodeError, SfrError
from sfr_loc_map.live.access import TOKEN_COOKIE, is_equal, refusal_of
from sfr_loc_map.live.commands import Action, Command
from sfr_loc_map.live.config import LiveConfig
from sfr_loc_map.live.connections import IDLE_TIMEOUT_S, BoundedConnections
from sfr_loc_map.live.messages import LIVE_PERIOD_S, CommonTexts
from sfr_loc_map.live.run_end import RunEnd
from sfr_loc_map.live.state import LiveState
from sfr_loc_map.live.values import state_json
from sfr_loc_map.live.viewer import Viewer
from sfr_loc_map.signals import stopping

if TYPE_CHECKING:  # the server itself requires no ROS
    from sfr_loc_map.live.operator import NodeOperator

CONTENT_TYPES = {"html": "text/html", "css": "text/css", "js": "text/javascript", "svg": "image/svg+xml"}
PLOTTING_LIBRARY = "plotly.min.js"  #: File of the plotly wheel.
TOKEN_MARK = b"@COMMAND_TOKEN@"
COMMAND_HEADER = "X-SFR-Token"
HEADERS = {
    # plotly.js writes inline styles and draws heat maps as data: images
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' blob: data:; "
        "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
REPORT_HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline' 'unsafe-eval'; img-src data: blob:; "
        "sandbox allow-scripts allow-modals allow-downloads; frame-ancestors 'none'"
    )
}
"""Headers of the report. Its scripts run with an opaque origin, so that they cannot access the page."""
CACHED = {"Cache-Control": "private, max-age=86400"}  #: Headers of the plotting library, which has 5 MB.
MAX_PAGES = 32
MAX_MESSAGE_BYTES = 4096  #: Maximum size of a command and of a message of a page.
HEARTBEAT_S = 20.0  #: Period of the websocket's ping, s.
SHUTDOWN_S = 1.0  #: Time, s, in which pending requests may be completed when the server ends.
LAST_MESSAGE_S = 0.1  #: Time, s, in which the last message may be sent to the pages.
TICK_S = 0.01  #: Changes within this time, s, are sent together.
END_PERIOD_S = 0.1  #: Period of the check whether the run is over, s.


class LiveServer:
    """Serves the page of a run at `url`. All methods but the constructor run in one event loop."""

    def __init__(self, config: LiveConfig, state: LiveState, operator: NodeOperator, title: str = "") -> None:
        """Read the page's files; the title, for example a namespace, is displayed in the header."""
        self.state = state
        self.url = ""  # known once the page is served
        self._config = config
        self._operator = operator
        self._title = title
        self._command_token = secrets.token_urlsafe(18)
        self._files = _page_files(self._command_token)
        self._viewers: list[Viewer] = []
        self._texts = CommonTexts(state)
        self._begin_s = time.time()
        self._connections: BoundedConnections | None = None
        self._changed = asyncio.Event()

    async def serve(self, ready: Callable[[str], None]) -> None:
        """Serve until the task is cancelled; `ready` is called with the address once the page can be opened."""
        logger = logging.getLogger("sfr_loc_map.live")
        logger.addFilter(_is_internal_error)
        runner = web.AppRunner(
            self._application(),
            access_log=None,
            handle_signals=False,
            logger=logger,
            keepalive_timeout=IDLE_TIMEOUT_S,
            shutdown_timeout=SHUTDOWN_S,
        )
        await runner.setup()
        assert runner.server is not None
        self._connections = BoundedConnections(runner.server)
        try:
            with closing(await self._listen(self._connections)) as listener:
                self.url = self._address(listener.sockets[0].getsockname()[1])
                self.state.call_on_change(self._wake_from_any_thread(asyncio.get_running_loop()))
                ready(self.url)
                await self._send_changes()
        finally:
            self._operator.close()
            await runner.cleanup()

    def show_end(self, run_end: RunEnd | None = None) -> None:
        """Report to the pages that the run is over, and how the run ended if this is known.

        Later silence is then not reported as stale data.
        """
        now_s = time.time()
        self.state.end(run_end or RunEnd(), now_s)
        self._notify_viewers(now_s, at_once=True)

    def _application(self) -> web.Application:
        app = web.Application(middlewares=[self._guard], client_max_size=MAX_MESSAGE_BYTES)
        app.add_routes(
            [
                web.get("/healthz", self._get_health),
                web.get("/state.json", self._get_state),
                web.get("/report", self._get_report),
                web.get("/ws", self._open_viewer),
                web.post("/command", self._run_command),
                web.get("/{name:[^/]*}", self._get_file),
            ]
        )
        return app

    async def _listen(self, connections: BoundedConnections) -> asyncio.Server:
        host, port = self._config.host, self._config.port
        try:
            return await asyncio.get_running_loop().create_server(connections, host, port)
        except OSError as error:
            reason = error.strerror or str(error)
            hint = "choose another --port (0: any free port)"
            raise NodeError(f"cannot listen on {host} port {port}: {reason}; {hint}") from error

    def _address(self, port: int) -> str:
        host, token = self._config.host, self._config.token
        name = f"[{host}]" if ":" in host else host
        query = f"?token={quote(token, safe='')}" if token else ""
        return f"http://{name}:{port}/{query}"

    def _wake_from_any_thread(self, loop: asyncio.AbstractEventLoop) -> Callable[[], None]:
        def wake() -> None:
            if not self._changed.is_set():
                with suppress(RuntimeError):  # the loop has ended
                    loop.call_soon_threadsafe(self._changed.set)

        return wake

    # ---- changes

    async def _send_changes(self) -> None:
        """Notify the pages of each change, and periodically of the state of the run."""
        while True:
            with suppress(TimeoutError):
                async with asyncio.timeout(LIVE_PERIOD_S):
                    await self._changed.wait()
            self._changed.clear()
            self._notify_viewers(time.time())
            await asyncio.sleep(TICK_S)

    def _notify_viewers(self, now_s: float, *, at_once: bool = False) -> None:
        self._texts.update(now_s, at_once=at_once)
        for viewer in self._viewers:
            viewer.notify(self._texts.by_kind)

    # ---- access

    @web.middleware
    async def _guard(
        self, request: web.Request, handler: Callable[[web.Request], Awaitable[web.StreamResponse]]
    ) -> web.StreamResponse:
        """Refuse requests without access; turn errors into one line of text; add the security headers."""
        assert self._connections is not None
        self._connections.note_request(request.protocol)
        refusal = refusal_of(request, self._config.token)
        try:
            if refusal and request.path != "/healthz":
                raise web.HTTPForbidden(reason=refusal)
            response = await handler(request)
        except web.HTTPException as error:
            response = web.Response(status=error.status, text=f"{error.reason}\n")
        if response.prepared:
            return response
        for name, value in HEADERS.items():
            response.headers.setdefault(name, value)
        if self._config.token and request.query.get("token") and not refusal:
            response.set_cookie(TOKEN_COOKIE, self._config.token, httponly=True, samesite="Strict")
        return response

    # ---- requests

    async def _get_file(self, request: web.Request) -> web.Response:
        name = request.match_info["name"] or "index.html"
        if name not in self._files:  # only the listed files are served
            raise web.HTTPNotFound
        headers = CACHED if name == PLOTTING_LIBRARY else None
        content_type = CONTENT_TYPES[name.rpartition(".")[2]]
        return web.Response(body=self._files[name], content_type=content_type, charset="utf-8", headers=headers)

    async def _get_health(self, request: web.Request) -> web.Response:
        return web.json_response({"status": "ok"})

    async def _get_state(self, request: web.Request) -> web.Response:
        now_s = time.time()
        content = state_json(self.state, now_s)
        content["live"]["server"] = {
            "version": __version__,
            "title": self._title,
            "uptime_s": round(now_s - self._begin_s, 3),
            "actions": sorted(Action),
            "pages": len(self._viewers),
        }
        return web.json_response(content, dumps=lambda value: json.dumps(value, allow_nan=False))

    async def _get_report(self, request: web.Request) -> web.Response:
        page = self.state.shown_end.report_page
        if not page:
            raise web.HTTPNotFound
        return web.Response(body=page, content_type="text/html", charset="utf-8", headers=REPORT_HEADERS)

    async def _run_command(self, request: web.Request) -> web.Response:
        if not is_equal(request.headers.get(COMMAND_HEADER, ""), self._command_token):
            return web.json_response(
                {"ok": False, "text": "the page was loaded from an earlier server: reload the page"}, status=403
            )
        try:
            async with asyncio.timeout(IDLE_TIMEOUT_S):
                content = await request.read()
            command = Command.parse(content)
            text = await asyncio.to_thread(self._operator.run, command)
        except TimeoutError:
            raise web.HTTPRequestTimeout from None
        except (SfrError, web.RequestPayloadError) as error:
            return web.json_response({"ok": False, "text": str(error)}, status=400)
        return web.json_response({"ok": True, "text": text})

    async def _open_viewer(self, request: web.Request) -> web.StreamResponse:
        """Serve the websocket of a page until it is closed."""
        if len(self._viewers) >= MAX_PAGES:
            raise web.HTTPServiceUnavailable
        channel = web.WebSocketResponse(heartbeat=HEARTBEAT_S, max_msg_size=MAX_MESSAGE_BYTES, compress=False)
        await channel.prepare(request)
        transport = request.transport
        if transport is None:
            return channel
        viewer = Viewer(self.state, channel)

        async def send() -> None:
            with suppress(ConnectionError, TimeoutError):
                await viewer.send_all(self._title)
            transport.abort()  # no closing handshake, because a page that does not read would never answer

        self._viewers.append(viewer)
        self._notify_viewers(time.time())
        sender = asyncio.create_task(send())
        try:
            async for received in channel:
                if received.type is WSMsgType.TEXT:
                    viewer.receive(received.data)
        finally:
            self._viewers.remove(viewer)
            self.state.watch(viewer, is_watching=False)
            sender.cancel()
        return channel


async def serve_until_signal(server: LiveServer, *, open_browser: bool = False, end_file: Path | None = None) -> None:
    """Serve until SIGINT, SIGTERM or SIGHUP; print the address when the page can be opened.

    Once the run is over, its process writes to `end_file` how the run ended (`RunEnd`). The pages display the end and
    can still be opened.
    """
    shown_version: tuple[int, int] | None = None

    def announce(url: str) -> None:
        print(f"live: {url}", flush=True)
        if open_browser:
            webbrowser.open(url)

    def show_end_of_run() -> None:
        """Display how the run ended, if its process has reported this since the last call."""
        nonlocal shown_version
        version = None if end_file is None else RunEnd.version(end_file)
        if end_file is None or version in (None, shown_version):
            return
        run_end = RunEnd.read(end_file)
        if run_end is not None:
            shown_version = version
            server.show_end(run_end)

    async def watch_run() -> None:
        while end_file is not None:
            show_end_of_run()
            await asyncio.sleep(END_PERIOD_S)

    def end_server() -> None:
        show_end_of_run()
        server.show_end()
        loop.call_later(LAST_MESSAGE_S, task.cancel)

    loop = asyncio.get_running_loop()
    task = asyncio.ensure_future(server.serve(announce))
    watch = asyncio.ensure_future(watch_run())
    try:
        with stopping(lambda: loop.call_soon_threadsafe(end_server)), suppress(asyncio.CancelledError):
            await task
    finally:
        watch.cancel()


def _page_files(command_token: str) -> dict[str, bytes]:
    """Return the files of the page and the plotting library by name."""
    folder = (files("sfr_loc_map.live") / "web").iterdir()
    found = {item.name: item.read_bytes() for item in folder if item.name.rpartition(".")[2] in CONTENT_TYPES}
    found["index.html"] = found["index.html"].replace(TOKEN_MARK, command_token.encode())
    found[PLOTTING_LIBRARY] = (files("plotly") / "package_data" / PLOTTING_LIBRARY).read_bytes()
    return found


def _is_internal_error(record: logging.LogRecord) -> bool:
    """Return whether a record is to be logged. A malformed request is only answered with an HTTP status."""
    error = record.exc_info[1] if record.exc_info else None
    return not isinstance(error, http_exceptions.HttpProcessingError | web.RequestPayloadError)
