"""Binary frames of the websocket: a header in JSON, padded to four bytes, and the bytes of one image or cloud.

bytes 0..3     length of the header with its padding, unsigned, little endian
bytes 4..      header: UTF-8 JSON, padded with spaces
the rest       image: a JPEG file; others: float32, little endian. cloud: `count` points, x y z sigma (and error, where
               `error` is true); elevation: `rows` times `columns` cells with the layers of `names`; tracks: `count`
               rows u v before_u before_v residual
"""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray32
from sfr_loc_map.live.updates import CloudSample, ElevationSample, ImageSample, Media, TrackSample


def frame(header: dict[str, Any], body: bytes) -> bytes:
    """Return a frame."""
    text = json.dumps(header, allow_nan=False, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    return struct.pack("<I", len(text)) + text + body


def frame_of(media: Media) -> bytes:
    """Return the frame of an image, a cloud, a map or tracks."""
    match media:
        case ImageSample():
            kind, facts, body = "image", _image_facts(media), media.jpeg
        case CloudSample():
            columns = media.points if media.error is None else np.column_stack([media.points, media.error])
            facts = {"count": len(media.points), "total": media.total, "error": media.error is not None}
            kind, body = "cloud", _bytes(columns)
        case ElevationSample():
            kind, facts, body = "elevation", _grid_facts(media), _bytes(media.layers)
        case TrackSample():
            masks = {side: [np.round(ring, 1).tolist() for ring in rings] for side, rings in media.masks.items()}
            kind, facts, body = "tracks", {"count": len(media.tracks), "masks": masks}, _bytes(media.tracks)
    name = {"type": kind, "topic": media.topic, "stamp_ns": str(media.stamp_ns), "published_s": media.published_s}
    return frame(name | facts, body)


def _image_facts(image: ImageSample) -> dict[str, Any]:
    return {"size": list(image.size), "full_size": list(image.full_size)}


def _grid_facts(grid: ElevationSample) -> dict[str, Any]:
    rows, columns, _ = grid.layers.shape
    place = {"rows": rows, "columns": columns, "origin_m": list(grid.origin_m), "cell_m": grid.cell_m}
    return place | {"names": list(grid.names), "every": grid.every}


def _bytes(values: FloatArray32) -> bytes:
    return np.ascontiguousarray(values, "<f4").tobytes()


def message(kind: str, content: dict[str, Any]) -> str:
    """Return a message of figures: JSON with its kind as `type`."""
    return json.dumps({"type": kind, **content}, allow_nan=False, separators=(",", ":"))
