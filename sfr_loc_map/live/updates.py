"""Records that a feed (the ROS node) passes to the live state.

Times are those of the host's system clock, s. Stamps are those of the messages. A new record is a member of `Update`,
and has a case in `LiveState._take_in`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from sfr_loc_map.calls.call_record import CallRecord
from sfr_loc_map.geometry.arrays import FloatArray, FloatArray32
from sfr_loc_map.message_types import Level, StatusKind
from sfr_loc_map.metrics.frames.covariance import UPPER, lost_by_covariance


class Track(StrEnum):
    """Source of poses."""

    ESTIMATE = "estimate"
    TRUTH = "truth"


@dataclass(frozen=True, slots=True)
class PublishedScore:
    """The score of the monitor, as JSON."""

    text: str
    received_s: float


@dataclass(frozen=True, slots=True)
class PoseSample:
    """A pose of RB in DS: position, m, quaternion, and for estimates the covariance `(6, 6)` in ROS order.

    The quaternion has unit length, or is 0 0 0 0 if the attitude is unknown, which is possible only for the truth.
    """

    track: Track
    stamp_ns: int
    position: tuple[float, float, float]
    quat_xyzw: tuple[float, float, float, float]
    received_s: float
    covariance: FloatArray | None = None

    @property
    def has_attitude(self) -> bool:
        """Whether the attitude is known."""
        return any(self.quat_xyzw)

    @property
    def is_lost(self) -> bool:
        """Whether the covariance marks the pose as lost."""
        return self.covariance is not None and bool(lost_by_covariance(self.covariance[UPPER][np.newaxis])[0])


@dataclass(frozen=True, slots=True)
class NodeCall:
    """A call of a node."""

    node: str
    record: CallRecord
    received_s: float


@dataclass(frozen=True, slots=True)
class Status:
    """A status of a node on /diagnostics: health, unusable input or internal fault."""

    node: str
    kind: StatusKind
    level: Level
    message: str
    values: Mapping[str, str]
    received_s: float


@dataclass(frozen=True, slots=True)
class ImageStamp:
    """Stamp and publication time of an image. Images are received only while a viewer displays them."""

    topic: str
    stamp_ns: int
    published_s: float


@dataclass(frozen=True, slots=True, eq=False)
class ImageSample:
    """An image reduced for the screen: JPEG data, width and height, and the original width and height."""

    topic: str
    stamp_ns: int
    jpeg: bytes
    size: tuple[int, int]
    full_size: tuple[int, int]
    published_s: float
    track_count: int = 0  # number of drawn feature tracks


@dataclass(frozen=True, slots=True)
class ImageProblem:
    """Why the images of a topic cannot be displayed; empty if they can."""

    topic: str
    text: str


@dataclass(frozen=True, slots=True, eq=False)
class ElevationSample:
    """A top-view map, thinned for the screen; its layers are named height, sigma, error, hazard, ..."""

    topic: str
    stamp_ns: int
    origin_m: tuple[float, float]  # corner of cell (0, 0), LM
    cell_m: float  # size of the displayed cells
    names: tuple[str, ...]
    layers: FloatArray32  # (rows along y, columns along x, names), NaN if unknown
    published_s: float
    every: int = 1  # grid cells per displayed cell along each axis


@dataclass(frozen=True, slots=True)
class GraphNodes:
    """Nodes of the suite that are in the graph, and the number of lost messages of each topic."""

    nodes: frozenset[str]
    received_s: float
    lost: Mapping[str, int] = field(default_factory=dict)


Media = ImageSample | ElevationSample  #: Large records, of which only the newest of each topic is kept.
Update = PublishedScore | PoseSample | NodeCall | Status | ImageStamp | Media | ImageProblem | GraphNodes
