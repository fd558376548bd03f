"""Images, feature tracks and clouds for the page: received only while one looks at them."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CompressedImage, Image, PointCloud2

from sfr_loc_map.constants import NS_PER_S, SIDES
from sfr_loc_map.errors import SfrError
from sfr_loc_map.geometry.plausibility import check_image_size
from sfr_loc_map.io.image_codec import image_from_compressed_message, image_from_message, stamp_of
from sfr_loc_map.live.cloud_truth import CloudTruth
from sfr_loc_map.live.hub import Hub
from sfr_loc_map.live.media import cloud_sample, image_sample
from sfr_loc_map.live.updates import Sampled, View
from sfr_loc_map.nodes.messages.point_cloud import cloud_from_msg
from sfr_loc_map.pipeline.online.transport_gaps import TransportGaps

IMAGE_PERIOD_S = 0.15
"""Shortest time between two images of a topic that are shown."""
TRACKS = "localisation/debug_image"
POINTS, TRUE_POINTS = "mapping/points", "ground_truth/points"
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
        self._shown_s: dict[str, float] = {}
        self._truth = CloudTruth()
        self._best_effort = QoSProfile(depth=2, reliability=ReliabilityPolicy.BEST_EFFORT)
        truth = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
        node.create_subscription(PointCloud2, TRUE_POINTS, self._on_true_points, truth)

    def follow(self, wanted: frozenset[View]) -> None:
        """Subscribe to what is wanted and to nothing else."""
        for view in View:
            if view in wanted and view not in self._subscriptions:
                self._subscriptions[view] = self._subscribe(view)
            elif view not in wanted:
                for subscription in self._subscriptions.pop(view, ()):
                    self._node.destroy_subscription(subscription)

    def _subscribe(self, view: View) -> list[Any]:
        if view is View.TRACKS:
            return [self._raw(Image, TRACKS, partial(self._on_tracks, TRACKS), self._best_effort)]
        if view is View.CLOUDS:
            latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
            return [self._raw(PointCloud2, POINTS, self._on_cloud, latched)]
        found = []
        for name in (f"{rig}/{side}" for rig in ("loc", "nav") for side in SIDES):
            for kind, end in ((Image, "image_rect"), (CompressedImage, "image_rect/compressed"), (Image, "image_raw")):
                received = partial(self._on_image, name, kind)
                found.append(self._raw(kind, f"{name}/{end}", received, self._best_effort))
        return found

    def _raw(self, kind: type[Any], topic: str, callback: Received, qos: QoSProfile) -> Any:  # noqa: ANN401 - rclpy's
        gaps = self.gaps.setdefault(topic, TransportGaps())

        def received(raw: bytes, info: dict[str, Any]) -> None:
            gaps.add(info)
            try:
                callback(raw, info)
            except (SfrError, ValueError):  # the node that is given it reports it
                return

        listener: Any = received  # rclpy's types do not know of raw messages with their information
        return self._node.create_subscription(kind, topic, listener, qos, raw=True)

    def _on_image(self, name: str, kind: type[Any], raw: bytes, info: dict[str, Any]) -> None:
        published_s = _published_s(info)
        self._hub.put(Sampled(name, _stamp_ns(raw), published_s))
        if not self._is_due(name):
            return
        message = deserialize_message(raw, kind)
        image = image_from_message(message) if kind is Image else image_from_compressed_message(message)
        self._hub.put(image_sample(name, stamp_of(message), image, published_s))

    def _on_tracks(self, name: str, raw: bytes, info: dict[str, Any]) -> None:
        if self._is_due(name):
            message = deserialize_message(raw, Image)
            self._hub.put(image_sample(name, stamp_of(message), _colours(message), _published_s(info)))

    def _on_cloud(self, raw: bytes, info: dict[str, Any]) -> None:
        message = deserialize_message(raw, PointCloud2)
        cloud = cloud_from_msg(message)
        error = self._truth.errors(cloud)
        self._hub.put(cloud_sample(POINTS, stamp_of(message), cloud.xyz, cloud.sigma, _published_s(info), error))

    def _on_true_points(self, message: PointCloud2) -> None:
        try:
            self._truth.add(stamp_of(message), message)
        except SfrError:
            return

    def _is_due(self, name: str) -> bool:
        now = time.monotonic()
        if now - self._shown_s.get(name, -IMAGE_PERIOD_S) < IMAGE_PERIOD_S:
            return False
        self._shown_s[name] = now
        return True


def _stamp_ns(raw: bytes) -> int:
    """Return the stamp of a serialised message that begins with a header (CDR: byte 1 tells the order of bytes)."""
    seconds, nanoseconds = struct.unpack_from("<iI" if raw[1] & 1 else ">iI", raw, STAMP_AT)
    return int(seconds) * NS_PER_S + int(nanoseconds)


def _published_s(info: dict[str, Any]) -> float:
    return (info.get("source_timestamp") or time.time_ns()) / NS_PER_S


def _colours(message: Image) -> NDArray[np.uint8]:
    """Return an image of encoding bgr8 as `(H, W, 3)`.

    Raises:
        ValueError: If it is of another encoding, or its data too short.
        GeometryError: If its size is that of no image.
    """
    height, width, step = int(message.height), int(message.width), int(message.step)
    check_image_size(width, height)
    data = np.frombuffer(message.data, np.uint8)
    if message.encoding != "bgr8" or step < 3 * width or len(data) < step * height:
        raise ValueError("no image of encoding bgr8")
    return data[: step * height].reshape(height, step)[:, : 3 * width].reshape(height, width, 3)
