"""Where the thread that receives a run and the one that shows it meet.

The receiving thread never waits: of images and clouds the newest replaces what nobody has taken yet, all other records
queue up to a bound, beyond which the oldest is dropped and counted.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from threading import Lock

from sfr_loc_map.live.updates import MEDIA, Media, Update, View

MAX_WAITING = 20_000
"""Records that wait: at 100 a second more than three minutes."""


def _no_one() -> None:
    """Wake nobody."""


class Hub:
    """Takes records of a feed in one thread and gives them out in another. All methods may be called in any thread.

    Attributes:
        dropped: Records that found no room, since the start.
        replaced: Images and clouds that a newer one replaced before they were taken, since the start.
    """

    def __init__(self) -> None:
        """Start empty, with nobody who looks on."""
        self.dropped = self.replaced = 0
        self._lock = Lock()
        self._waiting: deque[Update] = deque()
        self._newest: dict[tuple[type[Media], str], Media] = {}
        self._wanted: frozenset[View] = frozenset()
        self._wake: Callable[[], None] = _no_one

    def on_arrival(self, wake: Callable[[], None]) -> None:
        """Call something when records arrive where none waited; it must return at once."""
        self._wake = wake

    def put(self, update: Update) -> None:
        """Give a record; returns at once."""
        with self._lock:
            was_empty = not self._waiting and not self._newest
            if isinstance(update, MEDIA):
                key = (type(update), update.topic)
                self.replaced += key in self._newest
                self._newest[key] = update
            else:
                if len(self._waiting) >= MAX_WAITING:
                    self._waiting.popleft()
                    self.dropped += 1
                self._waiting.append(update)
        if was_empty:
            self._wake()

    def take(self) -> list[Update]:
        """Return all records that wait, in their order, images and clouds last."""
        with self._lock:
            updates: list[Update] = [*self._waiting, *self._newest.values()]
            self._waiting.clear()
            self._newest.clear()
        return updates

    @property
    def waiting(self) -> int:
        """How many records wait, but for images and clouds."""
        return len(self._waiting)

    @property
    def wanted(self) -> frozenset[View]:
        """What somebody looks at; a feed makes nothing else of it."""
        return self._wanted

    def want(self, views: frozenset[View]) -> None:
        """Say what somebody looks at."""
        self._wanted = views
