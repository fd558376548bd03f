"""One feed for several views, each with a hub of its own: none waits for another."""

from __future__ import annotations

from collections.abc import Sequence

from sfr_loc_map.live.hub import Hub
from sfr_loc_map.live.updates import Update, View


class Tee(Hub):
    """Gives each record to several hubs; wanted is what one of them wants. Nothing is taken from itself."""

    def __init__(self, hubs: Sequence[Hub]) -> None:
        """Feed these hubs."""
        super().__init__()
        self._hubs = tuple(hubs)

    def put(self, update: Update) -> None:
        """Give a record to all; returns at once."""
        for hub in self._hubs:
            hub.put(update)

    @property
    def waiting(self) -> int:
        """How many records wait where most do."""
        return max((hub.waiting for hub in self._hubs), default=0)

    @property
    def wanted(self) -> frozenset[View]:
        """What somebody looks at."""
        wanted: frozenset[View] = frozenset()
        for hub in self._hubs:
            wanted |= hub.wanted
        return wanted
