"""One page that looks on: what waits for it, and how fast it is sent.

Figures are sent in their order and none is left out. Of each image and cloud topic the newest alone waits. A page that
does not read is cut off after a bounded time or number of bytes.
"""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Callable
from typing import Protocol

from sfr_loc_map.live.updates import View

MAX_FIGURE_BYTES = 4_000_000
"""Figures that wait for a page; beyond them it is cut off."""
SEND_TIMEOUT_S = 10.0
"""A page that takes nothing for so long is cut off."""
PAUSE_S = 0.02


class Channel(Protocol):
    """Sends to a page; returns when the network has room again."""

    async def send_str(self, data: str) -> None:
        """Send a text."""
        ...

    async def send_bytes(self, data: bytes) -> None:
        """Send bytes."""
        ...


class Client:
    """The queue of one page. Used by the thread of the server's loop alone.

    Attributes:
        views: What it looks at.
        replaced: Images and clouds that were not sent, as a newer one came.
        sent_bytes: All that was sent.
        cut_off: Why it was cut off, empty otherwise.
    """

    def __init__(self, channel: Channel, bytes_per_s: float, clock: Callable[[], float] = time.monotonic) -> None:
        """Start with nothing to send.

        Args:
            channel: The page.
            bytes_per_s: Budget of images and clouds; figures count, but never wait for it.
            clock: Seconds, going forward.
        """
        self.views: frozenset[View] = frozenset()
        self.replaced = self.sent_bytes = 0
        self.cut_off = ""
        self._channel, self._rate, self._clock = channel, bytes_per_s, clock
        self._figures: deque[str] = deque()
        self._figure_bytes = 0
        self._media: dict[str, bytes] = {}
        self._credit, self._credited_s = bytes_per_s, clock()
        self._arrived = asyncio.Event()

    @property
    def waiting_bytes(self) -> int:
        """Bytes that wait for the page."""
        return self._figure_bytes + sum(map(len, self._media.values()))

    def add_figures(self, text: str) -> None:
        """Queue a message of figures."""
        self._figures.append(text)
        self._figure_bytes += len(text)
        if self._figure_bytes > MAX_FIGURE_BYTES:
            self.cut_off = f"did not read: {self._figure_bytes} bytes of figures waited"
            self._figures.clear()
            self._media.clear()
            self._figure_bytes = 0
        self._arrived.set()

    def add_media(self, topic: str, data: bytes) -> None:
        """Let an image or a cloud wait, in place of an older one of its topic."""
        self.replaced += topic in self._media
        self._media[topic] = data
        self._arrived.set()

    async def send_all(self) -> None:
        """Send what comes, until the page is cut off or gone.

        Raises:
            ConnectionError: If the page is gone.
        """
        while not self.cut_off:
            self._refill()
            try:
                if self._figures:
                    await asyncio.wait_for(self._send_figures(), SEND_TIMEOUT_S)
                elif self._media and self._credit > 0.0:
                    await asyncio.wait_for(self._send_media(), SEND_TIMEOUT_S)
                elif self._media:
                    await self._wait(PAUSE_S)
                else:
                    await self._wait(None)
            except TimeoutError:
                self.cut_off = f"did not read for {SEND_TIMEOUT_S:g} s"

    async def _send_figures(self) -> None:
        text = self._figures.popleft()
        self._figure_bytes -= len(text)
        self._spend(len(text))
        await self._channel.send_str(text)

    async def _send_media(self) -> None:
        topic = next(iter(self._media))  # the one that has waited longest
        data = self._media.pop(topic)
        self._spend(len(data))
        await self._channel.send_bytes(data)

    async def _wait(self, timeout_s: float | None) -> None:
        self._arrived.clear()
        try:
            await asyncio.wait_for(self._arrived.wait(), timeout_s)
        except TimeoutError:
            return

    def _spend(self, count: int) -> None:
        self._credit -= count
        self.sent_bytes += count

    def _refill(self) -> None:
        now = self._clock()
        self._credit = min(self._credit + (now - self._credited_s) * self._rate, self._rate)
        self._credited_s = now
