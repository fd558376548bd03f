"""Serves a run over the Foxglove protocol, in a thread of its own beside the page or the terminal."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from threading import Event, Lock, Thread
from typing import Any

import foxglove
from foxglove.channels import (
    CompressedImageChannel,
    GridChannel,
    ImageAnnotationsChannel,
    PointCloudChannel,
    PosesInFrameChannel,
    SceneUpdateChannel,
)
from foxglove.websocket import ChannelView, Client, ServerListener, WebSocketServer

from sfr_loc_map.errors import NodeError
from sfr_loc_map.live.foxglove import messages
from sfr_loc_map.live.hub import Hub
from sfr_loc_map.live.state import LiveState
from sfr_loc_map.live.updates import CloudSample, ElevationSample, ImageSample, Media, TrackSample, Update, View

HOST = "127.0.0.1"
"""The protocol has no token, so other hosts are not let in: a tunnel (ssh -L) reaches it."""
BACKLOG_MESSAGES = 64
"""Messages that wait for a client; beyond them the SDK drops the oldest."""
TICK_S = 0.1
PERIOD_S = 1.0
"""Time between two messages of figures, paths and scene."""
FIGURES, CALLS, ESTIMATE, TRUTH, SCENE = "/figures", "/calls", "/path/estimate", "/path/truth", "/path/scene"
POINTS, GRID = "/mapping/points", "/mapping/grid"
IMAGES = ("/loc/left", "/loc/right", "/nav/left", "/nav/right")
TRACKS = "/localisation/tracks"
VIEWS = {**dict.fromkeys(IMAGES, View.IMAGES), TRACKS: View.TRACKS, POINTS: View.CLOUDS, GRID: View.CLOUDS}
"""What a feed has to make for a topic."""
TOPICS = (FIGURES, CALLS, ESTIMATE, TRUTH, SCENE, POINTS, GRID, *IMAGES, TRACKS)


class Subscriptions(ServerListener):
    """Who looks at what. Called in threads of the SDK."""

    def __init__(self, hub: Hub) -> None:
        """Start with nobody.

        Args:
            hub: Is told what is wanted.
        """
        self._hub, self._lock = hub, Lock()
        self._clients: dict[str, set[int]] = {}
        self._new: set[str] = set()

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        """Note that a client wants a topic."""
        with self._lock:
            self._clients.setdefault(channel.topic, set()).add(client.id)
            self._new.add(channel.topic)
            self._want()

    def on_unsubscribe(self, client: Client, channel: ChannelView) -> None:
        """Note that it does not any more, or is gone."""
        with self._lock:
            self._clients.get(channel.topic, set()).discard(client.id)
            self._want()

    def take_new(self) -> set[str]:
        """Return the topics that somebody has begun to look at."""
        with self._lock:
            new, self._new = self._new, set()
        return new

    def _want(self) -> None:
        self._hub.want(frozenset(view for topic, view in VIEWS.items() if self._clients.get(topic)))


class FoxgloveView:
    """Serves what a hub brings; a context manager.

    Attributes:
        url: Address of the server, once it runs.
    """

    def __init__(self, hub: Hub, port: int, title: str) -> None:
        """Make the channels.

        Args:
            hub: Where the feed puts what it receives.
            port: Port on loopback; 0: a free one.
            title: Name of the server.
        """
        self.url = ""
        self._hub, self._port, self._title = hub, port, title
        self._state = LiveState()
        self._subscriptions = Subscriptions(hub)
        self._context = foxglove.Context()
        self._channels = _channels(self._context)
        self._server: WebSocketServer | None = None
        self._due_s, self._next_call = 0.0, 0
        self._stopped = Event()
        self._thread = Thread(target=self._run, name="sfr-live-foxglove", daemon=True)

    def __enter__(self) -> FoxgloveView:
        """Begin to serve.

        Raises:
            NodeError: If the port cannot be listened on.
        """
        try:
            self._server = foxglove.start_server(
                name=f"sfr live {self._title}",
                host=HOST,
                port=self._port,
                server_listener=self._subscriptions,
                context=self._context,
                message_backlog_size=BACKLOG_MESSAGES,
            )
        except Exception as error:
            place = f"{HOST} port {self._port}"
            raise NodeError(
                f"cannot listen on {place}: {error}; choose another --foxglove-port (0: a free one)"
            ) from error
        self.url = f"ws://{HOST}:{self._server.port}"
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """End."""
        self._stopped.set()
        self._thread.join(5.0)
        if self._server is not None:
            self._server.stop()
        for channel in self._channels.values():
            channel.close()

    def _run(self) -> None:
        while not self._stopped.wait(TICK_S):
            for update in self._hub.take():
                self._state.apply(update)
                self._show(update)
            self._show_calls()
            new = self._subscriptions.take_new()
            now_s = time.monotonic()
            if new or now_s >= self._due_s:
                self._due_s = now_s + PERIOD_S
                self._show_state()
            if new:
                self._show_latest(new)

    def _show(self, update: Update) -> None:
        match update:
            case ImageSample():
                self._send(_channel_of(update), lambda: messages.image(update))
            case CloudSample():
                self._send(_channel_of(update), lambda: messages.cloud(update))
            case ElevationSample():
                self._send(_channel_of(update), lambda: messages.grid(update))
            case TrackSample():
                self._send(_channel_of(update), lambda: messages.track_annotations(update, self._scale()))

    def _scale(self) -> float:
        """Return by how much the left image is reduced."""
        image = self._state.media.get("loc/left")
        return image.size[0] / image.full_size[0] if isinstance(image, ImageSample) else 1.0

    def _show_latest(self, topics: set[str]) -> None:
        """Show what came before somebody looked."""
        if CALLS in topics:
            for call in {call.node: call for call in self._state.calls}.values():
                self._send(CALLS, call.to_plain)
        for latest in self._state.media.values():
            if _channel_of(latest) in topics:
                self._show(latest)

    def _show_calls(self) -> None:
        for call in self._state.calls:
            if call.n >= self._next_call:
                self._next_call = call.n + 1
                self._send(CALLS, call.to_plain)

    def _show_state(self) -> None:
        rows = self._state.path.rows
        self._send(FIGURES, lambda: self._state.to_plain(time.time()))
        self._send(ESTIMATE, lambda: messages.estimates(rows))
        self._send(TRUTH, lambda: messages.truths(rows))
        self._send(SCENE, lambda: messages.scene(rows))

    def _send(self, topic: str, make: Callable[[], Any]) -> None:
        """Send a message where somebody looks; it is made for nobody else."""
        channel = self._channels.get(topic)
        if channel is None or not channel.has_sinks():
            return
        message = make()
        if message is not None:
            channel.log(json.dumps(message, allow_nan=False).encode() if isinstance(message, dict) else message)


def _channel_of(media: Media) -> str:
    return GRID if isinstance(media, ElevationSample) else f"/{media.topic}"


def _channels(context: foxglove.Context) -> dict[str, Any]:
    """Return all channels by topic; their classes have no common one."""
    any_object = {"type": "object", "title": "sfr-live/1", "additionalProperties": True}
    call = {"type": "object", "title": "sfr-call", "additionalProperties": True}
    channels: dict[str, Any] = {
        FIGURES: foxglove.Channel(FIGURES, schema=any_object, context=context),
        CALLS: foxglove.Channel(CALLS, schema=call, context=context),
        ESTIMATE: PosesInFrameChannel(ESTIMATE, context=context),
        TRUTH: PosesInFrameChannel(TRUTH, context=context),
        SCENE: SceneUpdateChannel(SCENE, context=context),
        POINTS: PointCloudChannel(POINTS, context=context),
        GRID: GridChannel(GRID, context=context),
        TRACKS: ImageAnnotationsChannel(TRACKS, context=context),
    }
    channels |= {topic: CompressedImageChannel(topic, context=context) for topic in IMAGES}
    return channels
