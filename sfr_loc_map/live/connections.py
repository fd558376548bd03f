"""Accepts the connections of the page's server, and bounds those that have not sent a request."""

from __future__ import annotations

from aiohttp import web

IDLE_TIMEOUT_S = 5.0  #: A connection without a complete request is closed after this time (aiohttp's keep-alive timer).
MAX_SILENT = 256  #: Connections without a request. More than asyncio accepts at once, so that a request is read first.


class BoundedConnections:
    """Protocol factory for `loop.create_server`: aiohttp's handlers, of which few may be silent.

    Each open socket is a file descriptor, so that clients that connect and send nothing could lock out all others.
    """

    def __init__(self, server: web.Server) -> None:
        self._server = server
        self._silent: dict[web.RequestHandler, None] = {}  # in the order of their connection

    def __call__(self) -> web.RequestHandler:
        """Return the handler of a new connection; the oldest silent connection is closed if there are too many."""
        if len(self._silent) >= MAX_SILENT:
            oldest = next(iter(self._silent))
            del self._silent[oldest]
            oldest.force_close()
        handler = self._server()
        self._silent[handler] = None
        return handler

    def has_asked(self, handler: web.RequestHandler) -> None:
        """Note that a connection has sent a request: from then on aiohttp's timer alone closes it."""
        self._silent.pop(handler, None)
