"""What a feed tells the live state: one small frozen record for each thing that has happened.

A feed is whatever receives a run: the ROS node, or the player of a recorded one. It puts records into a `Hub`. Times
are seconds of the host's system clock, stamps are those of the messages.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import ClassVar

from sfr_loc_map.geometry.arrays import FloatArray, FloatArray32

LOCALISATION, TRUTH, REPORT = "localisation/odometry", "ground_truth/odometry", "metrics/report"
POINTS, TRUE_POINTS, TRACKS = "mapping/points", "ground_truth/points", "localisation/tracks"
ELEVATION, HAZARD = "mapping/elevation", "mapping/hazard"


class Track(StrEnum):
    """Whose poses."""

    ESTIMATE = "estimate"
    TRUTH = "truth"


class StatusKind(StrEnum):
    """What a status of /diagnostics is about; the value is the last part of its name."""

    CALL = "call"
    HEALTH = "health"
    INPUT = "input"


class View(StrEnum):
    """What costs something to make, so that a feed makes it only where somebody looks at it."""

    IMAGES = "images"
    TRACKS = "tracks"
    CLOUDS = "clouds"


@dataclass(frozen=True, slots=True)
class Report:
    """The monitor's report: JSON of a score."""

    text: str
    received_s: float


@dataclass(frozen=True, slots=True)
class PoseSample:
    """One pose of RB in DS: metres, a unit quaternion, for estimates the covariance `(6, 6)` in ROS order."""

    track: Track
    stamp_ns: int
    position: tuple[float, float, float]
    quat_xyzw: tuple[float, float, float, float]
    received_s: float
    covariance: FloatArray | None = None


@dataclass(frozen=True, slots=True)
class Status:
    """One status of a node on /diagnostics; levels are 0 well, 1 warning, 2 error, 3 stale."""

    node: str
    kind: StatusKind
    level: int
    message: str
    values: Mapping[str, str]
    received_s: float


@dataclass(frozen=True, slots=True)
class Sampled:
    """When the images of a stamp were published, by which the delay of all that follows from them is told."""

    topic: str
    stamp_ns: int
    published_s: float


@dataclass(frozen=True, slots=True)
class ImageSample:
    """One image, reduced for the screen: a JPEG file, its width and height, and those before it was reduced."""

    view: ClassVar[View] = View.IMAGES
    topic: str
    stamp_ns: int
    jpeg: bytes
    size: tuple[int, int]
    full_size: tuple[int, int]
    published_s: float


@dataclass(frozen=True, slots=True, eq=False)
class CloudSample:
    """One cloud, thinned for the screen; metres, LM; float32, NaN where not known."""

    view: ClassVar[View] = View.CLOUDS
    topic: str
    stamp_ns: int
    points: FloatArray32  # (N, 4): x, y, z, sigma
    total: int  # points that it had
    published_s: float
    error: FloatArray32 | None = None  # (N,) distance to the truth


@dataclass(frozen=True, slots=True, eq=False)
class ElevationSample:
    """A map from above in cells, thinned for the screen; its layers are named height, sigma, error, hazard, ..."""

    view: ClassVar[View] = View.CLOUDS
    topic: str
    stamp_ns: int
    origin_m: tuple[float, float]  # corner of cell (0, 0), LM
    cell_m: float  # as it is shown
    names: tuple[str, ...]
    layers: FloatArray32  # (rows along y, columns along x, names), NaN where not known
    published_s: float
    every: int = 1  # cells of the grid, along each axis, for one that is shown


@dataclass(frozen=True, slots=True, eq=False)
class TrackSample:
    """What the localiser tracked in the images of a stamp, and where it looks for nothing."""

    view: ClassVar[View] = View.TRACKS
    topic: str
    stamp_ns: int
    tracks: FloatArray32  # (N, 5): pixel left, pixel in the newest keyframe, residual (>= 1: outlier; NaN: not found)
    masks: Mapping[str, tuple[FloatArray32, ...]]  # outlines (K, 2), pixels, of what is left out, by side
    published_s: float


@dataclass(frozen=True, slots=True)
class GraphView:
    """Which nodes of the suite are in the graph, and how many messages of each topic did not arrive at the feed."""

    nodes: frozenset[str]
    received_s: float
    lost: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class TimeLine:
    """Where the player of a recorded run is; `restarted` where it has gone back and what was shown does not hold."""

    at_s: float
    end_s: float
    playing: bool
    restarted: bool = False


Media = ImageSample | CloudSample | ElevationSample | TrackSample
"""What is large: the newest of each topic replaces what nobody has taken yet."""
Update = Report | PoseSample | Status | Sampled | Media | GraphView | TimeLine
