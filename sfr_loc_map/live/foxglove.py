"""Serves a run over the Foxglove protocol, in a thread of its own beside the page or the terminal."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterator
from threading import Event, Thread
from typing import Any

import foxglove
import numpy as np
from foxglove import channels, messages
from foxglove.websocket import WebSocketServer

from sfr_loc_map.errors import NodeError
from sfr_loc_map.inputs import NS_PER_S
from sfr_loc_map.live.hub import Hub
from sfr_loc_map.live.path import PathRow, Point
from sfr_loc_map.live.state import LiveState
from sfr_loc_map.live.updates import CloudSample, ElevationSample, ImageSample, Media, TrackSample, View

HOST = "127.0.0.1"  #: The protocol has no token, so other hosts are not let in: a tunnel (ssh -L) reaches it.
BACKLOG_MESSAGES = 64  #: Messages that wait for a client; beyond them the SDK drops the oldest.
TICK_S, PERIOD_S = 0.1, 1.0  #: Time between two looks at what has come, two messages of figures, paths and scene.
MAP_FRAME, DRIVE_FRAME = "lm", "ds"
FIGURES, CALLS, ESTIMATE, TRUTH, SCENE = "/figures", "/calls", "/path/estimate", "/path/truth", "/path/scene"
POINTS, GRID, TRACKS = "/mapping/points", "/mapping/grid", "/localisation/tracks"
IMAGES = ("/loc/left", "/loc/right", "/nav/left", "/nav/right")
VIEWS = {**dict.fromkeys(IMAGES, View.IMAGES), TRACKS: View.TRACKS, POINTS: View.CLOUDS, GRID: View.CLOUDS}
"""What a feed has to make for a topic."""
CHANNELS = {
    ESTIMATE: channels.PosesInFrameChannel,
    TRUTH: channels.PosesInFrameChannel,
    SCENE: channels.SceneUpdateChannel,
    POINTS: channels.PointCloudChannel,
    GRID: channels.GridChannel,
    TRACKS: channels.ImageAnnotationsChannel,
    **dict.fromkeys(IMAGES, channels.CompressedImageChannel),
}
TOPICS = (FIGURES, CALLS, *CHANNELS)
ERROR_SCALE = 20.0  #: So much larger are errors drawn than they are.
ELLIPSE_POINTS = 36
FLOAT32 = messages.PackedElementFieldNumericType.Float32
GREEN, BLUE = messages.Color(r=0.1, g=0.6, b=0.2, a=1.0), messages.Color(r=0.1, g=0.3, b=0.9, a=1.0)
VIOLET, GREY = messages.Color(r=0.86, g=0.24, b=0.86, a=1.0), messages.Color(r=0.6, g=0.6, b=0.6, a=1.0)
RED, YELLOW = messages.Color(r=0.9, g=0.1, b=0.1, a=1.0), messages.Color(r=0.9, g=0.7, b=0.0, a=1.0)


class FoxgloveView:
    """Serves what a hub brings at `url`, on a port of loopback (0: a free one); a context manager."""

    def __init__(self, hub: Hub, port: int, title: str) -> None:
        self.url = ""
        self._hub, self._port, self._title = hub, port, title
        self._state = LiveState()
        self._context = context = foxglove.Context()
        of_json = {FIGURES: "sfr-live/1", CALLS: "sfr-call"}
        self._channels: dict[str, Any] = {  # whose classes have no common one
            topic: foxglove.Channel(topic, schema={"type": "object", "title": name}, context=context)
            for topic, name in of_json.items()
        } | {topic: kind(topic, context=context) for topic, kind in CHANNELS.items()}
        self._server: WebSocketServer | None = None
        self._due_s, self._next_call = 0.0, 0
        self._stopped = Event()
        self._thread = Thread(target=self._run, name="sfr-live-foxglove", daemon=True)

    def __enter__(self) -> FoxgloveView:
        """Begin to serve; NodeError if the port cannot be listened on."""
        options: dict[str, Any] = {"message_backlog_size": BACKLOG_MESSAGES, "context": self._context}
        try:
            self._server = foxglove.start_server(name=f"sfr live {self._title}", host=HOST, port=self._port, **options)
        except Exception as error:
            hint = "choose another --foxglove-port (0: a free one)"
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
        state, before = self._state, set[str]()
        while not self._stopped.wait(TICK_S):
            for update in self._hub.take():
                state.apply(update)
                if isinstance(update, Media):
                    self._show(update)
            looked_at = {topic for topic, channel in self._channels.items() if channel.has_sinks()}
            new, now_s = looked_at - before, time.monotonic()
            if looked_at != before:
                before = looked_at
                self._hub.want(frozenset(VIEWS[topic] for topic in looked_at & VIEWS.keys()))
            for media in state.media.values():
                if _channel_of(media) in new:  # what came before somebody looked
                    self._show(media)
            latest = {call["node"]: call for call in state.calls} if CALLS in new else {}
            for call in (*latest.values(), *(call for call in state.calls if call["n"] >= self._next_call)):
                self._next_call = max(self._next_call, call["n"] + 1)
                self._send(CALLS, dict, call)
            if new or now_s >= self._due_s:
                self._due_s, rows = now_s + PERIOD_S, state.path.rows
                known = [row for row in rows if row.truth_m is not None]
                self._send(FIGURES, state.to_plain, time.time())
                self._send(ESTIMATE, _poses, rows, [row.position_m for row in rows])
                self._send(TRUTH, _poses, known, [row.truth_m for row in known])
                self._send(SCENE, _scene, rows)

    def _show(self, media: Media) -> None:
        left = self._state.media.get("loc/left")
        scale = left.size[0] / left.full_size[0] if isinstance(left, ImageSample) else 1.0
        self._send(_channel_of(media), _message, media, scale)

    def _send(self, topic: str, make: Callable[..., Any], *arguments: object) -> None:
        """Send a message where somebody looks; it is made for nobody else."""
        channel = self._channels.get(topic)
        if channel is not None and channel.has_sinks():
            content = make(*arguments)
            channel.log(json.dumps(content, allow_nan=False).encode() if isinstance(content, dict) else content)


def _channel_of(media: Media) -> str:
    return GRID if isinstance(media, ElevationSample) else f"/{media.topic}"


def _message(media: Media, scale: float) -> Any:  # noqa: ANN401 - messages have no common class
    """Return an image, a cloud (error NaN where not known), a map with its layers, or annotations of the left image.

    The left image is shown `scale` times as large as it was tracked in.
    """
    stamp = _stamp(media.stamp_ns)
    match media:
        case ImageSample():
            frame = media.topic.replace("/", "_")
            return messages.CompressedImage(timestamp=stamp, frame_id=frame, data=media.jpeg, format="jpeg")
        case CloudSample():
            error = np.full(len(media.points), np.nan, np.float32) if media.error is None else media.error
            columns = np.ascontiguousarray(np.column_stack([media.points, error]), "<f4")
            return messages.PointCloud(
                timestamp=stamp,
                frame_id=MAP_FRAME,
                pose=_pose((0.0, 0.0, 0.0)),
                point_stride=columns.strides[0],
                fields=_fields(("x", "y", "z", "sigma", "error")),
                data=columns.tobytes(),
            )
        case ElevationSample():
            layers = np.ascontiguousarray(media.layers, "<f4")
            return messages.Grid(
                timestamp=stamp,
                frame_id=MAP_FRAME,
                pose=_pose((*media.origin_m, 0.0)),
                column_count=layers.shape[1],
                cell_size=messages.Vector2(x=media.cell_m, y=media.cell_m),
                row_stride=layers.strides[0],
                cell_stride=layers.strides[1],
                fields=_fields(media.names),
                data=layers.tobytes(),
            )
        case TrackSample():
            return messages.ImageAnnotations(points=list(_annotations(media, stamp, scale)))


def _annotations(sample: TrackSample, stamp: messages.Timestamp, scale: float) -> Iterator[messages.PointsAnnotation]:
    """Yield inliers, outliers, landmarks not found, and outlines of masks."""
    tracks, residual, kinds = sample.tracks, sample.tracks[:, 4], messages.PointsAnnotationType
    found = np.isfinite(tracks[:, :4]).all(axis=1)
    missed = np.isnan(residual) & np.isfinite(tracks[:, 2:4]).all(axis=1)
    drawn = [
        (tracks[found & (residual < 1.0), :4].reshape(-1, 2), kinds.LineList, YELLOW),
        (tracks[found & (residual >= 1.0), :4].reshape(-1, 2), kinds.LineList, VIOLET),
        (tracks[missed, 2:4], kinds.Points, GREY),
        *((ring, kinds.LineLoop, RED) for ring in sample.masks.get("left", ())),
    ]
    for places, kind, color in drawn:
        points = [messages.Point2(x=x, y=y) for x, y in (places * np.float32(scale)).tolist()]
        yield messages.PointsAnnotation(timestamp=stamp, type=kind, points=points, outline_color=color, thickness=1.0)


def _scene(rows: list[PathRow]) -> messages.SceneUpdate:
    """Return both paths, the errors enlarged and the 3-sigma ellipse of the newest pose as lines."""
    truths, errors = list[Point](), list[Point]()
    for row in rows:
        if row.truth_m is not None and row.error_m is not None:
            (x, y, z), (a, b, c) = row.truth_m, row.error_m
            truths.append(row.truth_m)
            errors += row.truth_m, (x + ERROR_SCALE * a, y + ERROR_SCALE * b, z + ERROR_SCALE * c)
    kinds = messages.LinePrimitiveLineType
    lines = (
        ("truth", GREEN, truths, kinds.LineStrip),
        ("estimate", BLUE, [row.position_m for row in rows], kinds.LineStrip),
        ("error", RED, errors, kinds.LineList),
        ("3 sigma", YELLOW, _ellipse(rows[-1]) if rows else [], kinds.LineLoop),
    )
    look: dict[str, Any] = {"pose": _pose((0.0, 0.0, 0.0)), "thickness": 2.0, "scale_invariant": True}
    entities = []
    for name, color, places, kind in lines:
        points = [messages.Point3(x=x, y=y, z=z) for x, y, z in places]
        line = messages.LinePrimitive(type=kind, points=points, color=color, **look)
        entities.append(messages.SceneEntity(timestamp=_newest(rows), frame_id=DRIVE_FRAME, id=name, lines=[line]))
    return messages.SceneUpdate(entities=entities)


def _ellipse(row: PathRow) -> list[Point]:
    """Return the 3-sigma ellipse of the position, x and y, of the size it has."""
    if row.covariance_xy_m2 is None:
        return []
    xx, yy, xy = row.covariance_xy_m2
    values, axes = np.linalg.eigh(np.array([[xx, xy], [xy, yy]]))
    half = 3.0 * np.sqrt(np.maximum(values, 0.0))
    angles = np.linspace(0.0, 2.0 * math.pi, ELLIPSE_POINTS, endpoint=False)
    ring = axes @ (half[:, None] * np.stack([np.cos(angles), np.sin(angles)]))
    x, y, z = row.position_m
    return [(x + dx, y + dy, z) for dx, dy in ring.T.tolist()]


def _poses(rows: list[PathRow], places: list[Point | None]) -> messages.PosesInFrame:
    """Return positions; attitudes are not shown."""
    poses = [_pose(place) for place in places if place is not None]
    return messages.PosesInFrame(timestamp=_newest(rows), frame_id=DRIVE_FRAME, poses=poses)


def _newest(rows: list[PathRow]) -> messages.Timestamp:
    return _stamp(rows[-1].stamp_ns if rows else 0)


def _pose(place: Point) -> messages.Pose:
    x, y, z = place
    level = messages.Quaternion(x=0.0, y=0.0, z=0.0, w=1.0)
    return messages.Pose(position=messages.Vector3(x=x, y=y, z=z), orientation=level)


def _fields(names: tuple[str, ...]) -> list[messages.PackedElementField]:
    return [messages.PackedElementField(name=name, offset=4 * n, type=FLOAT32) for n, name in enumerate(names)]


def _stamp(stamp_ns: int) -> messages.Timestamp:
    return messages.Timestamp(sec=stamp_ns // NS_PER_S, nsec=stamp_ns % NS_PER_S)
