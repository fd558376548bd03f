"""Serve a run over the Foxglove protocol, in its own thread beside the page or the terminal."""

from __future__ import annotations

import json
import time
from threading import Event, Thread
from typing import Any

import foxglove
import numpy as np
from foxglove import channels, messages
from foxglove.websocket import WebSocketServer

from sfr_loc_map.errors import NodeError
from sfr_loc_map.inputs import NS_PER_S
from sfr_loc_map.live.path import Point
from sfr_loc_map.live.state import LiveState
from sfr_loc_map.live.updates import CloudSample, ElevationSample, ImageSample, Media, MediaKind

HOST = "127.0.0.1"  #: Only loopback, because the protocol has no token; other hosts need a tunnel (ssh -L).
BACKLOG_MESSAGES = 64  #: Maximum number of messages that wait for a client; the SDK drops the oldest.
TICK_S = 0.1  #: Period of the check for new images and maps.
PERIOD_S = 1.0  #: Period of figures and paths.
FIGURES = "/figures"
ESTIMATE = "/path/estimate"
TRUTH = "/path/truth"
POINTS = "/mapping/points"
GRID = "/mapping/grid"
IMAGES = ("/loc/left", "/loc/right", "/nav/left", "/nav/right")
KINDS = {**dict.fromkeys(IMAGES, MediaKind.IMAGES), POINTS: MediaKind.CLOUDS, GRID: MediaKind.MAPS}
"""Kind of the media of each topic."""
CHANNELS = {
    ESTIMATE: channels.PosesInFrameChannel,
    TRUTH: channels.PosesInFrameChannel,
    POINTS: channels.PointCloudChannel,
    GRID: channels.GridChannel,
    **dict.fromkeys(IMAGES, channels.CompressedImageChannel),
}
TOPICS = (FIGURES, *CHANNELS)
FLOAT32 = messages.PackedElementFieldNumericType.Float32


class FoxgloveServer:
    """Serves a state at `url`, on a loopback port (0: any free port); a context manager."""

    def __init__(self, state: LiveState, port: int, title: str) -> None:
        self.url = ""
        self._state, self._port, self._title = state, port, title
        self._context = context = foxglove.Context()
        figures = foxglove.Channel(FIGURES, schema={"type": "object", "title": "sfr-live/1"}, context=context)
        self._channels: dict[str, Any] = {FIGURES: figures}  # the classes have no common base
        self._channels |= {topic: kind(topic, context=context) for topic, kind in CHANNELS.items()}
        self._server: WebSocketServer | None = None
        self._stopped = Event()
        self._thread = Thread(target=self._run, name="sfr-live-foxglove", daemon=True)

    def __enter__(self) -> FoxgloveServer:
        """Start serving; raise a NodeError if the port is not available."""
        options: dict[str, Any] = {"message_backlog_size": BACKLOG_MESSAGES, "context": self._context}
        try:
            self._server = foxglove.start_server(name=f"sfr live {self._title}", host=HOST, port=self._port, **options)
        except Exception as error:
            hint = "choose another --foxglove-port (0: any free port)"
            raise NodeError(f"cannot listen on {HOST} port {self._port}: {error}; {hint}") from error
        self.url = f"ws://{HOST}:{self._server.port}"
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopped.set()
        self._thread.join(5.0)
        if self._server is not None:
            self._server.stop()
        for channel in self._channels.values():
            channel.close()

    def _run(self) -> None:
        viewed_before: set[str] = set()
        sent: dict[str, Media] = {}  # sent media by topic
        due_s = 0.0
        try:
            while not self._stopped.wait(TICK_S):
                viewed = {topic for topic, channel in self._channels.items() if channel.has_sinks()}
                self._state.displayed.show(self, frozenset(KINDS[topic] for topic in viewed & KINDS.keys()))
                sent = self._send_media(viewed, sent)
                if viewed and (viewed - viewed_before or time.monotonic() >= due_s):
                    due_s = time.monotonic() + PERIOD_S
                    self._send_figures()
                viewed_before = viewed
        finally:
            self._state.displayed.forget(self)

    def _send_media(self, viewed: set[str], sent: dict[str, Media]) -> dict[str, Media]:
        """Send the images and maps of viewed topics that differ from the sent ones; return those that are now sent."""
        shown = self._state.shown_media(self).values()
        newest = {GRID if isinstance(media, ElevationSample) else f"/{media.topic}": media for media in shown}
        current = {topic: newest[topic] for topic in viewed & newest.keys()}
        for topic, media in current.items():
            if sent.get(topic) is not media:
                self._channels[topic].log(_message(media))
        return current

    def _send_figures(self) -> None:
        """Send the state as JSON, and both paths."""
        with self._state.lock:
            rows, newest = self._state.path.drawn, self._state.path.newest
        self._channels[FIGURES].log(json.dumps(self._state.to_plain(time.time()), allow_nan=False).encode())
        stamp = _stamp(0 if newest is None else newest.stamp_ns)
        estimate, truth = [row.position_m for row in rows], [row.truth_m for row in rows if row.truth_m]
        for topic, places in ((ESTIMATE, estimate), (TRUTH, truth)):
            poses = [_pose(place) for place in places]
            self._channels[topic].log(messages.PosesInFrame(timestamp=stamp, frame_id="ds", poses=poses))


def _message(media: Media) -> Any:  # noqa: ANN401 - messages have no common class
    """Return the message of an image, a cloud (error NaN if unknown), or a map with its layers."""
    stamp = _stamp(media.stamp_ns)
    if isinstance(media, ImageSample):
        frame = media.topic.replace("/", "_")
        return messages.CompressedImage(timestamp=stamp, frame_id=frame, data=media.jpeg, format="jpeg")
    if isinstance(media, CloudSample):
        error = np.full(len(media.points), np.nan, np.float32) if media.error is None else media.error
        columns = np.ascontiguousarray(np.column_stack([media.points, error]), "<f4")
        return messages.PointCloud(
            timestamp=stamp,
            frame_id="lm",
            pose=_pose((0.0, 0.0, 0.0)),
            point_stride=columns.strides[0],
            fields=_fields(("x", "y", "z", "sigma", "error")),
            data=columns.tobytes(),
        )
    assert isinstance(media, ElevationSample)  # there are no other media
    layers = np.ascontiguousarray(media.layers, "<f4")
    return messages.Grid(
        timestamp=stamp,
        frame_id="lm",
        pose=_pose((*media.origin_m, 0.0)),
        column_count=layers.shape[1],
        cell_size=messages.Vector2(x=media.cell_m, y=media.cell_m),
        row_stride=layers.strides[0],
        cell_stride=layers.strides[1],
        fields=_fields(media.names),
        data=layers.tobytes(),
    )


def _pose(place: Point) -> messages.Pose:
    """Return a pose with the identity as attitude, because attitudes are not displayed."""
    x, y, z = place
    level = messages.Quaternion(x=0.0, y=0.0, z=0.0, w=1.0)
    return messages.Pose(position=messages.Vector3(x=x, y=y, z=z), orientation=level)


def _fields(names: tuple[str, ...]) -> list[messages.PackedElementField]:
    return [messages.PackedElementField(name=name, offset=4 * n, type=FLOAT32) for n, name in enumerate(names)]


def _stamp(stamp_ns: int) -> messages.Timestamp:
    return messages.Timestamp(sec=stamp_ns // NS_PER_S, nsec=stamp_ns % NS_PER_S)
