"""Images, feature tracks and maps for the page: received only while one looks at them."""

from __future__ import annotations

import struct
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

from nav_msgs.msg import OccupancyGrid
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CompressedImage, Image, PointCloud2

from sfr_loc_map.errors import SfrError
from sfr_loc_map.geometry.arrays import FloatArray32
from sfr_loc_map.inputs import NS_PER_S, SIDES
from sfr_loc_map.io.image_codec import image_from_message, stamp_of
from sfr_loc_map.live.hub import Hub
from sfr_loc_map.live.media import file_sample, image_sample, outlines
from sfr_loc_map.live.updates import ELEVATION, HAZARD, POINTS, TRACKS, TRUE_POINTS, Sampled, TrackSample, View
from sfr_loc_map.nodes.live.map_feed import MapFeed
from sfr_loc_map.nodes.messages.tracks import MASK_SCALE, tracks_from_msg
from sfr_loc_map.pipeline.reception import TransportGaps

IMAGE_PERIOD_S = 0.15
"""Shortest time between two pairs of images that are shown."""
TRACKED = "loc/left"
"""The image that tracks are drawn on; of its stamps that are not shown they are left out."""
MAX_SHOWN = 64
"""Images of which tracks are waited for: ten seconds."""
MAX_MAPS = 8
"""Clouds, elevation and hazard grids that wait; more are left out."""
MASK_HOLD_NS = NS_PER_S // 2
"""A mask that much older than the tracks is shown with them."""
IMAGE_KINDS = ((Image, "image_rect"), (CompressedImage, "image_rect/compressed"), (Image, "image_raw"))
NO_EVENTS = SubscriptionEventCallbacks(use_default_callbacks=False)
"""The nodes themselves tell of peers that do not fit; each event would cost the executor time at every message."""
STAMP_AT = 4
"""Where the stamp of a serialised message with a header begins: behind the head of its encoding."""
Received = Callable[[bytes, dict[str, Any]], None]


class MediaFeed:
    """Subscribes to images and clouds while they are wanted. Used by the thread of the feed alone.

    Attributes:
        gaps: Messages of the wanted topics that did not arrive.
    """

    def __init__(self, node: Node, hub: Hub) -> None:
        """Subscribe to the true points, which are published once and are what clouds are compared with.

        Args:
            node: Receives.
            hub: Takes images and clouds.
        """
        self.gaps: dict[str, TransportGaps] = {}
        self._node, self._hub = node, hub
        self._subscriptions: dict[View, list[Any]] = {}
        self._due: dict[str, tuple[float, int]] = {}
        self._shown: deque[int] = deque(maxlen=MAX_SHOWN)
        self._masks: dict[str, tuple[int, tuple[FloatArray32, ...]]] = {}
        self._map = MapFeed(hub, lambda: bool(node.count_publishers(ELEVATION)))
        self._worker, self._maps_waiting = ThreadPoolExecutor(1, "sfr-live-maps"), 0
        self._best_effort = QoSProfile(depth=2, reliability=ReliabilityPolicy.BEST_EFFORT)
        truth = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
        self._raw(PointCloud2, TRUE_POINTS, partial(self._on_map, PointCloud2, self._map.add_true_points), truth)

    def follow(self, wanted: frozenset[View]) -> None:
        """Subscribe to what is wanted and to nothing else; of images to those topics that somebody publishes."""
        for view in View:
            if view in wanted and view not in self._subscriptions:
                self._subscriptions[view] = self._subscribe(view)
            elif view not in wanted:
                for subscription in self._subscriptions.pop(view, ()):
                    self._node.destroy_subscription(subscription)
        if View.IMAGES in wanted:
            self._follow_images(self._subscriptions[View.IMAGES])

    def _follow_images(self, subscriptions: list[Any]) -> None:
        known = {subscription.topic_name for subscription in subscriptions}
        for name in (f"{rig}/{side}" for rig in ("loc", "nav") for side in SIDES):
            for kind, end in IMAGE_KINDS:
                topic = f"{name}/{end}"
                if self._node.resolve_topic_name(topic) not in known and self._node.count_publishers(topic):
                    received = partial(self._on_image, name, kind)
                    subscriptions.append(self._raw(kind, topic, received, self._best_effort))

    def _subscribe(self, view: View) -> list[Any]:
        if view is View.TRACKS:
            found = [
                self._raw(Image, f"localisation/{side}_mask", partial(self._on_mask, side), self._best_effort)
                for side in SIDES
            ]
            return [*found, self._raw(PointCloud2, TRACKS, self._on_tracks, self._best_effort)]
        if view is View.CLOUDS:
            latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
            return [
                self._raw(kind, topic, partial(self._on_map, kind, add), latched)
                for topic, kind, add in (
                    (POINTS, PointCloud2, self._map.add_cloud),
                    (ELEVATION, PointCloud2, self._map.add_elevation),
                    (HAZARD, OccupancyGrid, self._map.add_hazard),
                )
            ]
        return []

    def _raw(self, kind: type[Any], topic: str, callback: Received, qos: QoSProfile) -> Any:  # noqa: ANN401 - rclpy's
        gaps = self.gaps.setdefault(topic, TransportGaps())

        def received(raw: bytes, info: dict[str, Any]) -> None:
            gaps.add(info)
            try:
                callback(raw, info)
            except (SfrError, ValueError):  # the node that is given it reports it
                return

        listener: Any = received  # rclpy's types do not know of raw messages with their information
        return self._node.create_subscription(kind, topic, listener, qos, event_callbacks=NO_EVENTS, raw=True)

    def _on_image(self, name: str, kind: type[Any], raw: bytes, info: dict[str, Any]) -> None:
        published_s, stamp_ns = _published_s(info), _stamp_ns(raw)
        self._hub.put(Sampled(name, stamp_ns, published_s))
        if not self._is_due(name.partition("/")[0], stamp_ns):
            return
        if name == TRACKED:
            self._shown.append(stamp_ns)
        message = deserialize_message(raw, kind)
        if kind is Image:
            self._hub.put(image_sample(name, stamp_of(message), image_from_message(message), published_s))
        else:
            self._hub.put(file_sample(name, stamp_of(message), bytes(message.data), published_s))

    def _on_mask(self, side: str, raw: bytes, info: dict[str, Any]) -> None:
        message = deserialize_message(raw, Image)
        self._masks[side] = stamp_of(message), outlines(image_from_message(message), MASK_SCALE)

    def _on_tracks(self, raw: bytes, info: dict[str, Any]) -> None:
        stamp_ns = _stamp_ns(raw)
        if stamp_ns not in self._shown:
            return
        found = tracks_from_msg(deserialize_message(raw, PointCloud2))
        masks = {side: rings for side, (at_ns, rings) in self._masks.items() if 0 <= stamp_ns - at_ns <= MASK_HOLD_NS}
        self._hub.put(TrackSample(TRACKS, stamp_ns, found, masks, _published_s(info)))

    def _on_map(self, kind: type[Any], add: Callable[[Any, float], None], raw: bytes, info: dict[str, Any]) -> None:
        """Take a map in, beside the thread that receives: figures do not wait for it."""
        if self._maps_waiting >= MAX_MAPS:
            return
        self._maps_waiting += 1
        self._worker.submit(self._work, kind, add, raw, _published_s(info))

    def _work(self, kind: type[Any], add: Callable[[Any, float], None], raw: bytes, published_s: float) -> None:
        try:
            add(deserialize_message(raw, kind), published_s)
        except (SfrError, ValueError):  # as below
            return
        finally:
            self._maps_waiting -= 1

    def close(self) -> None:
        """End the worker."""
        self._worker.shutdown(cancel_futures=True)

    def _is_due(self, rig: str, stamp_ns: int) -> bool:
        """Tell whether the images of a stamp are shown: both, and not more than a screen needs."""
        due_s, chosen_ns = self._due.get(rig, (0.0, -1))
        now = time.monotonic()
        if now >= due_s:
            self._due[rig] = now + IMAGE_PERIOD_S, stamp_ns
        return now >= due_s or stamp_ns == chosen_ns


def _stamp_ns(raw: bytes) -> int:
    """Return the stamp of a serialised message that begins with a header (CDR: byte 1 tells the order of bytes)."""
    seconds, nanoseconds = struct.unpack_from("<iI" if raw[1] & 1 else ">iI", raw, STAMP_AT)
    return int(seconds) * NS_PER_S + int(nanoseconds)


def _published_s(info: dict[str, Any]) -> float:
    return (info.get("source_timestamp") or time.time_ns()) / NS_PER_S
