"""Binary frames of the websocket: a header in JSON, padded to four bytes, and the bytes of one image or cloud.

bytes 0..3     length of the header with its padding, unsigned, little endian
bytes 4..      header: UTF-8 JSON, padded with spaces
the rest       image: a JPEG file; cloud: `count` points, x y z sigma (and error, where `error` is true) as float32,
little endian, point by point
"""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np

from sfr_loc_map.live.updates import CloudSample, ImageSample


def frame(header: dict[str, Any], body: bytes) -> bytes:
    """Return a frame."""
    text = json.dumps(header, allow_nan=False, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    return struct.pack("<I", len(text)) + text + body


def image_frame(image: ImageSample) -> bytes:
    """Return the frame of an image."""
    header = {
        "type": "image",
        "topic": image.topic,
        "stamp_ns": str(image.stamp_ns),
        "size": list(image.size),
        "full_size": list(image.full_size),
        "published_s": image.published_s,
    }
    return frame(header, image.jpeg)


def cloud_frame(cloud: CloudSample) -> bytes:
    """Return the frame of a cloud."""
    columns = cloud.points if cloud.error is None else np.column_stack([cloud.points, cloud.error])
    header = {
        "type": "cloud",
        "topic": cloud.topic,
        "stamp_ns": str(cloud.stamp_ns),
        "count": len(cloud.points),
        "total": cloud.total,
        "error": cloud.error is not None,
        "published_s": cloud.published_s,
    }
    return frame(header, np.ascontiguousarray(columns, "<f4").tobytes())


def message(kind: str, content: dict[str, Any]) -> str:
    """Return a message of figures: JSON with its kind as `type`."""
    return json.dumps({"type": kind, **content}, allow_nan=False, separators=(",", ":"))
