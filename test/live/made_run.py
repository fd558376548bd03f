"""An invented run: what a feed would put into a hub, without ROS."""

from __future__ import annotations

import time

import numpy as np
from made_scores import START_NS, drive, whole_score

from sfr_loc_map.live.hub import Hub
from sfr_loc_map.live.media import cloud_sample, image_sample
from sfr_loc_map.live.updates import (
    GraphView,
    PoseSample,
    Report,
    Sampled,
    Status,
    StatusKind,
    Track,
    Update,
)
from sfr_loc_map.metrics.score_json import to_json

NODES = ("localisation_node", "mapping_node", "monitor_node")
SIZE = (240, 320)
FRAMES = 120


def pose_updates(number: int, now_s: float, *, lost: bool = False) -> list[Update]:
    """True and estimated pose of a frame, and when its image was published."""
    estimates, truth = drive(FRAMES)
    covariance = np.eye(6) * (9999.0 if lost else 1e-6 * (number + 1))
    rows = ((Track.TRUTH, truth, None), (Track.ESTIMATE, estimates.trajectory, covariance))
    stamp_ns = int(truth.stamps_ns[number])
    updates: list[Update] = [Sampled("loc/left", stamp_ns, now_s)]
    for track, path, found in rows:
        x, y, z = path.positions[number].tolist()
        a, b, c, d = path.quats_xyzw[number].tolist()
        updates.append(PoseSample(track, stamp_ns, (x, y, z), (a, b, c, d), now_s, found))
    return updates


def call_update(number: int, now_s: float, state: str = "tracking") -> Status:
    values = {
        "stamp_ns": str(START_NS + number),
        "state": state,
        "processing_time_s": repr(0.03 + 0.004 * float(np.sin(number))),
        "latency_transport_s": "0.002",
        "latency_receive_to_publish_s": "0.041",
        "peak_rss_bytes": "390000000",
    }
    return Status("localisation_node", StatusKind.CALL, 0, state, values, now_s)


def health_update(node: str, now_s: float, level: int = 0, message: str = "tracking") -> Status:
    values = {
        "lifecycle": "active",
        "received_messages_hz": "20.0",
        "processed_hz": "10.0",
        "waiting": "0",
        "resident_memory_bytes": "390000000",
        "dropped_in_transport": "0",
        "dropped_overload": "2",
    }
    return Status(node, StatusKind.HEALTH, level, message, values, now_s)


def image_update(topic: str, stamp_ns: int, now_s: float) -> Update:
    v, u = np.mgrid[: SIZE[0], : SIZE[1]]
    image = (127 + 60 * np.sin(u / 9.0) + 60 * np.cos(v / 7.0)).astype(np.uint8)
    return image_sample(topic, stamp_ns, image, now_s)


def cloud_update(stamp_ns: int, now_s: float, count: int = 60_000) -> Update:
    rng = np.random.default_rng(5)
    xy = rng.uniform((-1.0, -6.0), (12.0, 6.0), (count, 2))
    z = 0.2 * np.sin(xy[:, 0]) + 0.1 * np.cos(2 * xy[:, 1])
    sigma = 1e-3 * np.hypot(*xy.T) ** 2
    error = np.abs(rng.normal(0.0, sigma + 1e-6))
    return cloud_sample("mapping/points", stamp_ns, np.column_stack([xy, z]), sigma, now_s, error)


def fill(hub: Hub, frames: int = 60) -> None:
    """Put a whole run into a hub."""
    now_s = time.time()
    for node in NODES:
        hub.put(health_update(node, now_s))
    for number in range(frames):
        for update in pose_updates(number, now_s):
            hub.put(update)
        hub.put(call_update(number, now_s))
    hub.put(Report(to_json(whole_score(100, 48, 2, 2)), now_s))
    hub.put(GraphView(frozenset(NODES), now_s, {"localisation/odometry": 0}))
    for topic in ("loc/left", "loc/right", "localisation/debug_image"):
        hub.put(image_update(topic, START_NS, now_s))
    hub.put(cloud_update(START_NS, now_s))
