"""Send the state to an open page (`messages`): all poses and calls in order, and the newest of all other data.

New data are sent when the network accepts them. Data are not queued per page; only the state stores them. A page that
does not read is disconnected.
"""

from __future__ import annotations

import asyncio
from bisect import bisect_left
from contextlib import suppress
from operator import attrgetter
from typing import Any

from aiohttp import web

from sfr_loc_map.json_yaml import parse_json
from sfr_loc_map.live.messages import binary_message, text_message
from sfr_loc_map.live.path import PathRow
from sfr_loc_map.live.state import LiveState
from sfr_loc_map.live.updates import Media
from sfr_loc_map.report.glossary import TERMS

SEND_TIMEOUT_S = 10.0  #: A page that accepts no data for this time is disconnected.


class Viewer:
    """An open page, and the messages sent to it. Used only in the server's event loop."""

    def __init__(self, state: LiveState, channel: web.WebSocketResponse) -> None:
        self._state = state
        self._channel = channel
        self._is_visible = False
        self._changed = asyncio.Event()
        self._texts: dict[str, str] = {}  # latest message of each kind that is sent to all pages
        self._sent_texts: dict[str, str] = {}
        self._sent_media: dict[str, Media] = {}  # by topic, oldest first
        self._path_version = -1  # version of the path that was sent
        self._next_row = 0
        self._last_row: PathRow | None = None  # last pose that was sent
        self._next_call = 0
        self._first_call = 0

    def notify(self, texts: dict[str, str]) -> None:
        """Record a change, with the latest messages that are sent to all pages."""
        self._texts = texts
        self._changed.set()

    def receive(self, text: str) -> None:
        """Process a message of the page, which states whether the page is visible."""
        content: Any = None
        with suppress(ValueError):
            content = parse_json(text)
        match content:
            case {"type": "visible", "visible": bool(is_visible)}:
                self._is_visible = is_visible
                self._state.watch(self, is_watching=is_visible)
        self._changed.set()

    async def send_all(self, title: str) -> None:
        """Send new data until a ConnectionError (the page has left) or a TimeoutError (the page accepts no data)."""
        await self._send(text_message("hello", {"title": title, "terms": {**TERMS}}))
        while True:
            self._changed.clear()
            for text in (*self._new_texts(), *self._new_rows(), *self._new_calls()):
                await self._send(text)
            media = self._next_media()
            if media is None:
                await self._changed.wait()
                continue
            self._sent_media.pop(media.topic, None)
            self._sent_media[media.topic] = media
            await self._send(binary_message(media))

    def _new_texts(self) -> list[str]:
        new = [text for kind, text in self._texts.items() if text != self._sent_texts.get(kind)]
        self._sent_texts = dict(self._texts)
        return new

    def _new_rows(self) -> list[str]:
        """Return the poses that are new to the page, and the last pose; all poses after a thinning or a restart."""
        with self._state.lock:
            path = self._state.path
            is_whole = path.version != self._path_version
            self._path_version = path.version
            first = 0 if is_whole else bisect_left(path.rows, self._next_row, key=attrgetter("n"))
            rows = path.rows[first:]
            before_m, last = path.before_m, path.newest
        if last is self._last_row and not is_whole:
            return []
        self._last_row = last
        self._next_row = 0 if last is None else last.n + 1
        plain = [row.to_plain() for row in rows]
        last_plain = None if last is None else last.to_plain()
        return [text_message("path", {"whole": is_whole, "rows": plain, "last": last_plain, "before_m": before_m})]

    def _new_calls(self) -> list[str]:
        """Return the calls that are new to the page, and the number of the first call that the page keeps."""
        with self._state.lock:
            first, end = self._state.calls.first, self._state.calls.end
            calls = [call for call in self._state.calls if call.n >= self._next_call]
        if (first, end) == (self._first_call, self._next_call):
            return []
        self._first_call, self._next_call = first, end
        return [text_message("calls", {"first": first, "calls": [call.to_plain() for call in calls]})]

    def _next_media(self) -> Media | None:
        """Return a new image or map for a visible page, from the topic that has waited longest."""
        if not self._is_visible:
            return None
        with self._state.lock:
            newest = dict(self._state.media)
        never_sent = [topic for topic in newest if topic not in self._sent_media]
        for topic in (*never_sent, *self._sent_media):
            media = newest.get(topic)
            if media is not None and self._sent_media.get(topic) is not media:
                return media
        return None

    async def _send(self, data: str | bytes) -> None:
        async with asyncio.timeout(SEND_TIMEOUT_S):
            if isinstance(data, str):
                await self._channel.send_str(data)
            else:
                await self._channel.send_bytes(data)
