"""Messages between the server and a page over the websocket.

Text messages of the server are JSON objects with their kind as `type`:

    hello     title, terms               the first message: name of the run, and terms of the tables
    live      values.live_values         state of the run, every `LIVE_PERIOD_S`; also shows that the server is alive
    score     values.score_values        score of the monitor, when it has changed
    events    values.event_values        all events, when one of them begins or ends
    path      whole, rows, last,         new poses, and the last one; if `whole`, the poses replace the earlier ones;
              before_m                   distance travelled before the first pose
    calls     first, calls               new calls; the page keeps no call before the number `first`

`live`, `score` and `events` are equal for all pages (`CommonTexts`), and a `Viewer` sends each page its own `path` and
`calls`. Binary messages are images and top-view maps (`binary_message`). A page sends only
`{"type": "visible", "visible": true}`, or false: it is sent images and maps while it is visible.
"""

from __future__ import annotations

import json
import struct
from functools import lru_cache
from typing import Any

import numpy as np

from sfr_loc_map.live.shown_score import ShownScore
from sfr_loc_map.live.state import LiveState
from sfr_loc_map.live.updates import ImageSample, Media
from sfr_loc_map.live.values import event_values, live_values, score_values

LIVE_PERIOD_S = 0.25  #: Period at which the state of the run is sent, s.


def text_message(kind: str, content: dict[str, Any]) -> str:
    """Return a text message: JSON with the kind as `type`."""
    return json.dumps({"type": kind, **content}, allow_nan=False, separators=(",", ":"))


@lru_cache(maxsize=16)
def binary_message(media: Media) -> bytes:
    """Return the message of an image or a top-view map.

    bytes 0..3     length of the header with its padding, unsigned, little endian
    bytes 4..      header: UTF-8 JSON, padded with spaces to a multiple of four bytes
    the rest       image: a JPEG file; map: float32, little endian, `rows` x `columns` cells with the layers `names`
    """
    header: dict[str, Any] = {"topic": media.topic, "stamp_ns": str(media.stamp_ns)}
    if isinstance(media, ImageSample):
        header |= {"type": "image", "size": media.size, "full_size": media.full_size, "tracks": media.track_count}
        body = media.jpeg
    else:
        rows, columns, _ = media.layers.shape
        header |= {"type": "elevation", "rows": rows, "columns": columns, "names": media.names}
        header |= {"origin_m": media.origin_m, "cell_m": media.cell_m, "every": media.every}
        body = np.ascontiguousarray(media.layers, "<f4").tobytes()
    head = json.dumps(header, allow_nan=False, separators=(",", ":")).encode()
    head += b" " * (-len(head) % 4)
    return struct.pack("<I", len(head)) + head + body


class CommonTexts:
    """The latest text message of each kind that is equal for all pages."""

    def __init__(self, state: LiveState) -> None:
        self.by_kind: dict[str, str] = {}
        self._state = state
        self._score: ShownScore | None = None
        self._events_version = -1
        self._live_s = 0.0  # time of the last message `live`

    def update(self, now_s: float, *, at_once: bool = False) -> None:
        """Update the messages whose content has changed; `live` is updated at its period, or now if `at_once`."""
        state = self._state
        is_due = at_once or not 0.0 <= now_s - self._live_s < LIVE_PERIOD_S
        with state.lock:
            if is_due:
                state.tick(now_s)
            if state.score is not None and state.score is not self._score:
                self._score = state.score
                self.by_kind["score"] = text_message("score", score_values(state))
            if self._events_version != state.timeline.version:
                self._events_version = state.timeline.version
                self.by_kind["events"] = text_message("events", event_values(state))
            if is_due:
                self._live_s = now_s
                self.by_kind["live"] = text_message("live", live_values(state, now_s))
