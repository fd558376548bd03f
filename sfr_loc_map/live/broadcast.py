"""What the pages are sent: figures as they change, images and clouds as they come, the load of the server itself."""

from __future__ import annotations

import math
import time
from typing import Any

from sfr_loc_map.inputs import parse_json
from sfr_loc_map.live.client import Client
from sfr_loc_map.live.commands import Operator
from sfr_loc_map.live.hub import Hub
from sfr_loc_map.live.state import ROW_FIELDS, LiveState
from sfr_loc_map.live.updates import (
    MEDIA,
    CloudSample,
    ElevationSample,
    ImageSample,
    Report,
    TimeLine,
    TrackSample,
    Update,
    View,
)
from sfr_loc_map.live.wire import frame_of, message

VIEW_OF = {
    ImageSample: View.IMAGES,
    TrackSample: View.TRACKS,
    CloudSample: View.CLOUDS,
    ElevationSample: View.CLOUDS,
}
"""What a page looks at that is sent it."""
NODES_PERIOD_S = 0.5
"""At least so often the pages hear of the nodes, and by that of the server."""


class Broadcast:
    """Keeps what each page has been sent. Used by the thread of the server's loop alone.

    Attributes:
        clients: The pages.
    """

    def __init__(self, state: LiveState, hub: Hub, operator: Operator) -> None:
        """Start without pages.

        Args:
            state: What is known of the run.
            hub: Is told what the pages look at.
            operator: Says what can be asked of the nodes.
        """
        self.clients: list[Client] = []
        self._state, self._hub, self._operator = state, hub, operator
        self._media: dict[str, bytes] = {}
        self._version, self._next_row, self._next_call = state.path.version, 0, 0
        self._report_changed = False
        self._nodes_sent_s = 0.0
        self._silent_before: frozenset[str] = frozenset()
        self._cut_off = self._replaced_of_gone = 0

    def join(self, client: Client, server: dict[str, Any]) -> None:
        """Give a page all that is known, and from now on what changes."""
        state = self._state
        client.add_figures(message("hello", {"server": server, "row_fields": ROW_FIELDS}))
        if state.report is not None:
            client.add_figures(message("report", state.report.to_plain()))
        # Exactly what the others have been sent: what is new comes to all.
        rows = [row for row in state.path.rows if row.n < self._next_row]
        client.add_figures(self._path_message(rows, whole=True))
        calls = [call for call in state.calls if call.n < self._next_call]
        client.add_figures(message("calls", {"calls": [call.to_plain() for call in calls], "whole": True}))
        client.add_figures(self._nodes_message(time.time()))
        for key, data in self._media.items():
            client.add_media(key, data)
        self.clients.append(client)

    def leave(self, client: Client) -> None:
        """Send a page nothing any more."""
        self.clients.remove(client)
        self._replaced_of_gone += client.replaced
        self._tell_wanted()

    def receive(self, client: Client, text: str) -> None:
        """Take a message of a page in: what it looks at, or a request for the server's time."""
        try:
            content = parse_json(text)
        except ValueError:
            return
        if not isinstance(content, dict):
            return
        if content.get("type") == "want" and isinstance(content.get("views"), list):
            client.views = frozenset(view for view in View if view.value in content["views"])
            self._tell_wanted()
        elif content.get("type") == "ping":
            sent_ms = content.get("sent_ms")
            if isinstance(sent_ms, (int, float)) and math.isfinite(sent_ms):
                client.add_figures(message("pong", {"sent_ms": sent_ms, "time_s": time.time()}))

    def note(self, update: Update) -> None:
        """Note a record that the state has taken in."""
        if isinstance(update, Report):
            self._report_changed = True
        elif isinstance(update, MEDIA):
            self._offer(update.topic, frame_of(update), VIEW_OF[type(update)])
        elif isinstance(update, TimeLine) and update.restarted:
            self._media.clear()
            self._to_all(message("calls", {"calls": [], "whole": True}))

    def send(self, now_s: float) -> None:
        """Send the figures that have changed."""
        state = self._state
        if self._report_changed and state.report is not None:
            self._report_changed = False
            self._to_all(message("report", state.report.to_plain()))
        self._send_rows()
        calls = [call for call in state.calls if call.n >= self._next_call]
        if calls:
            self._next_call = calls[-1].n + 1
            self._to_all(message("calls", {"calls": [call.to_plain() for call in calls], "whole": False}))
        silent = self._silent(now_s)
        if now_s - self._nodes_sent_s >= NODES_PERIOD_S or silent != self._silent_before:
            self._nodes_sent_s, self._silent_before = now_s, silent
            self._to_all(self._nodes_message(now_s))

    def end(self) -> None:
        """Tell all pages that the run is over."""
        self._to_all(message("end", {"time_s": time.time()}))

    def load(self) -> dict[str, Any]:
        """Return what the pages cost and what was thinned for them."""
        return {
            "pages": len(self.clients),
            "waiting_bytes": sum(client.waiting_bytes for client in self.clients),
            "replaced": self._replaced_of_gone + self._hub.replaced + sum(client.replaced for client in self.clients),
            "dropped": self._hub.dropped,
            "cut_off": self._cut_off,
        }

    def note_cut_off(self) -> None:
        """Count a page that was cut off."""
        self._cut_off += 1

    def _silent(self, now_s: float) -> frozenset[str]:
        """Return the names of nodes and topics that are silent."""
        state = self._state
        nodes = {name for name, node in state.nodes.items() if node.is_stale(now_s)}
        return frozenset(nodes | {name for name, topic in state.topics.items() if topic.is_stale(now_s)})

    def _send_rows(self) -> None:
        path = self._state.path
        whole = path.version != self._version
        self._version = path.version
        rows = path.rows if whole else [row for row in path.rows if row.n >= self._next_row]
        if rows or whole:
            self._next_row = rows[-1].n + 1 if rows else 0
            self._to_all(self._path_message(rows, whole=whole))

    def _path_message(self, rows: list[Any], *, whole: bool) -> str:
        state = self._state
        content = {
            "whole": whole,
            "rows": [state.row_to_plain(row) for row in rows],
            "under_way": state.under_way_to_plain(),
        }
        return message("path", content)

    def _nodes_message(self, now_s: float) -> str:
        live = self._state.live_to_plain(now_s, tables=False)
        return message("nodes", live | {"load": self.load(), "actions": sorted(self._operator.actions)})

    def _offer(self, key: str, data: bytes, view: View) -> None:
        self._media[key] = data
        for client in self.clients:
            if view in client.views:
                client.add_media(key, data)

    def _to_all(self, text: str) -> None:
        for client in self.clients:
            client.add_figures(text)

    def _tell_wanted(self) -> None:
        wanted: frozenset[View] = frozenset()
        for client in self.clients:
            wanted |= client.views
        self._hub.want(wanted)
