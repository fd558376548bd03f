"""The pages that look on, and what each has been sent.

A page takes what is new for it when the network has room, so nothing waits here but what the state keeps anyway: all
figures in their order, of each image and cloud topic the newest. One that does not read is cut off.
"""

from __future__ import annotations

import asyncio
import json
import math
import struct
import time
from bisect import bisect_left
from collections.abc import Callable, Iterator
from contextlib import suppress
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray32
from sfr_loc_map.inputs import parse_json
from sfr_loc_map.live import updates
from sfr_loc_map.live.hub import Hub
from sfr_loc_map.live.path import ROW_FIELDS
from sfr_loc_map.live.state import LiveState, ReportView

if TYPE_CHECKING:
    from aiohttp import web

SEND_TIMEOUT_S = 10.0
"""A page that takes nothing for so long is cut off."""
PAUSE_S = 0.02
NODES_PERIOD_S = 0.5
"""At least so often the pages hear of the nodes, and by that of the server."""


def message(kind: str, content: dict[str, Any]) -> str:
    """Return a message of figures: JSON with its kind as `type`."""
    return json.dumps({"type": kind, **content}, allow_nan=False, separators=(",", ":"))


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


class Pages:
    """What all pages are shown, and how many there are. Used by the thread of the server's loop alone."""

    def __init__(self, state: LiveState, hub: Hub) -> None:
        """Start without pages; the hub is told what they look at."""
        self.state = state
        self.pages: list[Page] = []
        self.report_text = self.nodes_text = ""  # the latest messages, empty before the first
        self.frames: dict[str, tuple[updates.Media, bytes]] = {}  # the newest of each topic with its bytes
        self.is_over = False
        self.cut_off = self.replaced = 0
        self._hub = hub
        self._report: ReportView | None = None
        self._nodes_s = 0.0
        self._silent: frozenset[str] = frozenset()

    def note(self, update: updates.Update) -> None:
        """Note a record that the state has taken in."""
        if isinstance(update, updates.Media) and update.topic in self.state.media:
            before, _ = self.frames.get(update.topic, (None, b""))
            looking = [page for page in self.pages if before is not None and update.view in page.views]
            self.replaced += sum(page.sent.get(update.topic) is not before for page in looking)
            self.frames[update.topic] = update, frame_of(update)
        elif isinstance(update, updates.TimeLine) and update.restarted:
            self.frames.clear()

    def tell(self, now_s: float) -> None:
        """Let the pages send what has changed."""
        report, silent = self.state.report, self.state.silent(now_s)
        if report is not None and report is not self._report:
            self._report, self.report_text = report, message("report", report.to_plain())
        if now_s - self._nodes_s >= NODES_PERIOD_S or silent != self._silent:
            self._nodes_s, self._silent = now_s, silent
            live = self.state.live_to_plain(now_s, tables=False)
            self.nodes_text = message("nodes", live | {"load": self.load(), "actions": self._hub.actions})
        for page in self.pages:
            page.news.set()

    def join(self, page: Page) -> None:
        """Count a page."""
        self.pages.append(page)
        self.tell(time.time())

    def leave(self, page: Page) -> None:
        """Count a page no more."""
        self.pages.remove(page)
        self._want()

    def receive(self, page: Page, text: str) -> None:
        """Take a message of a page in: what it looks at, or a request for the server's time."""
        try:
            content = parse_json(text)
        except ValueError:
            return
        if not isinstance(content, dict):
            return
        if content.get("type") == "want" and isinstance(content.get("views"), list):
            page.views = frozenset(view for view in updates.View if view.value in content["views"])
            self._want()
        elif content.get("type") == "ping":
            sent_ms = content.get("sent_ms")
            if isinstance(sent_ms, int | float) and math.isfinite(sent_ms):
                page.pong = message("pong", {"sent_ms": sent_ms, "time_s": time.time()})
                page.news.set()

    def load(self) -> dict[str, Any]:
        """Return what the pages cost and what was thinned for them."""
        return {
            "pages": len(self.pages),
            "waiting_bytes": sum(page.waiting() for page in self.pages),
            "replaced": self._hub.replaced + self.replaced,
            "dropped": self._hub.dropped,
            "cut_off": self.cut_off,
        }

    def _want(self) -> None:
        self._hub.want(frozenset().union(*(page.views for page in self.pages)))


class Page:
    """One page: how far it is, what it looks at. Used by the thread of the server's loop alone."""

    def __init__(
        self,
        pages: Pages,
        channel: web.WebSocketResponse,
        bytes_per_s: float,
        waiting: Callable[[], int] = lambda: 0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Start with nothing sent; the budget is that of images and clouds, figures count but never wait for it.

        How many bytes wait for the network tells `waiting`.
        """
        self.views: frozenset[updates.View] = frozenset()
        self.news = asyncio.Event()
        self.pong = ""
        self.waiting = waiting
        self.sent: dict[str, updates.Media] = {}  # of each topic the last; the topic that was sent last is the last
        self._all, self._channel, self._rate, self._clock = pages, channel, bytes_per_s, clock
        self._credit, self._credited_s = bytes_per_s, clock()
        self._report = self._nodes = ""
        self._version = -1  # of the path, which changes with each restart of a player
        self._next_row = self._next_call = 0

    async def send_all(self, server: dict[str, Any]) -> None:
        """Greet the page and send what is new, until it is cut off.

        Raises:
            ConnectionError: If the page is gone.
        """
        try:
            await self._send(message("hello", {"server": server, "row_fields": ROW_FIELDS}))
            ended = False
            while True:
                self.news.clear()
                for text in self._new_figures():
                    await self._send(text)
                if self._all.is_over and not ended:
                    ended = True
                    await self._send(message("end", {"time_s": time.time()}))
                topic, now_s = self._waiting_topic(), self._clock()
                self._credit = min(self._credit + (now_s - self._credited_s) * self._rate, self._rate)
                self._credited_s = now_s
                if topic is None:
                    await self.news.wait()
                elif self._credit > 0.0:
                    media, data = self._all.frames[topic]
                    self.sent.pop(topic, None)
                    self.sent[topic] = media
                    await self._send(data)
                else:
                    with suppress(TimeoutError):
                        await asyncio.wait_for(self.news.wait(), PAUSE_S)
        except TimeoutError:
            self._all.cut_off += 1

    def _new_figures(self) -> Iterator[str]:
        """Yield what the page has not been sent: report, path, calls, nodes, answers."""
        every, state = self._all, self._all.state
        if every.report_text is not self._report:
            self._report = every.report_text
            yield self._report
        path = state.path
        whole = path.version != self._version
        rows = path.rows if whole else path.rows[bisect_left(path.rows, self._next_row, key=attrgetter("n")) :]
        if whole or rows:
            self._version, self._next_row = path.version, rows[-1].n + 1 if rows else 0
            content = {"whole": whole, "rows": [row.to_plain() for row in rows], "under_way": path.under_way}
            yield message("path", content)
        calls = [call for call in state.calls if whole or call["n"] >= self._next_call]
        if whole or calls:
            self._next_call = calls[-1]["n"] + 1 if calls else self._next_call
            yield message("calls", {"calls": calls, "whole": whole})
        if every.nodes_text is not self._nodes:
            self._nodes = every.nodes_text
            yield self._nodes
        if self.pong:
            pong, self.pong = self.pong, ""
            yield pong

    def _waiting_topic(self) -> str | None:
        """Return a topic whose newest frame it looks at and has not been sent, the one that was sent longest ago."""
        frames = self._all.frames
        for topic in (*(topic for topic in frames if topic not in self.sent), *self.sent):
            media, _ = frames.get(topic, (None, b""))
            if media is not None and media.view in self.views and self.sent.get(topic) is not media:
                return topic
        return None

    async def _send(self, data: str | bytes) -> None:
        self._credit -= len(data)
        send = self._channel.send_str(data) if isinstance(data, str) else self._channel.send_bytes(data)
        await asyncio.wait_for(send, SEND_TIMEOUT_S)
