"""Accept the connections of the page's server, with a bound on connections without a request."""

from __future__ import annotations

from aiohttp import web

IDLE_TIMEOUT_S = 5.0  #: A connection without a complete request is closed after this time (aiohttp's keep-alive timer).
MAX_SILENT = 256
"""Maximum number of connections without a request. asyncio accepts fewer connections at a time, so that a connection
is not closed before its request is read."""


class BoundedConnections:
    """Protocol factory for `loop.create_server` that creates aiohttp's handlers, with a bound on silent connections.

    Each open socket uses a file descriptor, so clients that connect and send nothing could lock out all others.
    """

    def __init__(self, server: web.Server) -> None:
        self._server = server
        self._silent: dict[web.RequestHandler, None] = {}  # oldest connection first

    def __call__(self) -> web.RequestHandler:
        """Return the handler of a new connection; the oldest silent connection is closed if there are too many."""
        if len(self._silent) >= MAX_SILENT:
            oldest = next(iter(self._silent))
            del self._silent[oldest]
            oldest.force_close()
        handler = self._server()
        self._silent[handler] = None
        return handler

    def note_request(self, handler: web.RequestHandler) -> None:
        """Record that a connection has sent a request; from now on only aiohttp's timer closes the connection."""
        self._silent.pop(handler, None)
