"""The media that the open views display."""

from __future__ import annotations

from threading import Lock

from sfr_loc_map.live.updates import MediaKind


class DisplayedMedia:
    """The kinds of media that each viewer displays. Methods may be called in any thread."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._kinds: dict[object, frozenset[MediaKind]] = {}

    @property
    def wanted(self) -> frozenset[MediaKind]:
        """Media that at least one viewer displays; a feed prepares only these."""
        with self._lock:
            return frozenset[MediaKind]().union(*self._kinds.values())

    def kinds_of(self, viewer: object) -> frozenset[MediaKind]:
        """Return the media that a viewer displays."""
        with self._lock:
            return self._kinds.get(viewer, frozenset())

    def show(self, viewer: object, kinds: frozenset[MediaKind]) -> None:
        """Note which media a viewer displays."""
        with self._lock:
            self._kinds[viewer] = kinds

    def forget(self, viewer: object) -> None:
        """Record that a viewer has left."""
        with self._lock:
            self._kinds.pop(viewer, None)
