"""What a feed tells the live state: one small frozen record for each thing that has happened.

A feed is whatever receives a run (the ROS node, a player of a recorded source). It puts records into a `Hub`; times are
seconds of the host's system clock, stamps are those of the messages.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from sfr_loc_map.geometry.arrays import FloatArray, FloatArray32


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
    """The monitor's report.

    Attributes:
        text: JSON of the score.
        received_s: When it was received.
    """

    text: str
    received_s: float


@dataclass(frozen=True, slots=True)
class PoseSample:
    """One pose of RB in DS.

    Attributes:
        track: Whose.
        stamp_ns: Its stamp.
        position: Metres.
        quat_xyzw: Unit quaternion.
        received_s: When it was received.
        covariance: `(6, 6)` of the pose in ROS order; None of a true pose.
    """

    track: Track
    stamp_ns: int
    position: tuple[float, float, float]
    quat_xyzw: tuple[float, float, float, float]
    received_s: float
    covariance: FloatArray | None = None


@dataclass(frozen=True, slots=True)
class Status:
    """One status of a node on /diagnostics.

    Attributes:
        node: Name of the node, such as `localisation_node`.
        kind: What it is about.
        level: 0 well, 1 warning, 2 error, 3 stale.
        message: In words.
        values: Figures and words by name.
        received_s: When it was received.
    """

    node: str
    kind: StatusKind
    level: int
    message: str
    values: Mapping[str, str]
    received_s: float


@dataclass(frozen=True, slots=True)
class Sampled:
    """When the images of a stamp were published, by which the delay of all that follows from them is told.

    Attributes:
        topic: Topic of the image.
        stamp_ns: Its stamp.
        published_s: When it was published.
    """

    topic: str
    stamp_ns: int
    published_s: float


@dataclass(frozen=True, slots=True)
class ImageSample:
    """One image, reduced for the screen.

    Attributes:
        topic: Where it comes from, such as `loc/left`.
        stamp_ns: Its stamp.
        jpeg: The image as a JPEG file.
        size: Its width and height.
        full_size: Width and height before it was reduced.
        published_s: When it was published.
    """

    topic: str
    stamp_ns: int
    jpeg: bytes
    size: tuple[int, int]
    full_size: tuple[int, int]
    published_s: float


@dataclass(frozen=True, slots=True)
class CloudSample:
    """One cloud, thinned for the screen.

    Attributes:
        topic: Where it comes from, such as `mapping/points`.
        stamp_ns: Its stamp.
        points: `(N, 4)` float32: x, y, z, sigma in metres, LM; sigma is NaN where it is not known.
        total: How many points it had.
        published_s: When it was published.
        error: `(N,)` distance to the truth in metres, None where it is not known.
    """

    topic: str
    stamp_ns: int
    points: FloatArray32
    total: int
    published_s: float
    error: FloatArray32 | None = None


@dataclass(frozen=True, slots=True, eq=False)
class ElevationSample:
    """A map from above in cells, thinned for the screen.

    Attributes:
        topic: Where it comes from.
        stamp_ns: Its stamp.
        origin_m: Corner of cell (0, 0), LM.
        cell_m: Side of a cell as it is shown.
        names: Names of the layers, of `height`, `sigma`, `error` (metres), `hazard` (0 to 100), `slope` (radians),
            `roughness`, `step` (metres) and `count`.
        layers: `(rows along y, columns along x, len(names))` float32, NaN where not known.
        published_s: When it was published.
        every: Cells of the grid, along each axis, for one that is shown.
    """

    topic: str
    stamp_ns: int
    origin_m: tuple[float, float]
    cell_m: float
    names: tuple[str, ...]
    layers: FloatArray32
    published_s: float
    every: int = 1


@dataclass(frozen=True, slots=True, eq=False)
class TrackSample:
    """What the localiser tracked in the images of a stamp, and where it looks for nothing.

    Attributes:
        topic: Where it comes from.
        stamp_ns: Stamp of the images.
        tracks: `(N, 5)` float32: pixel in the left image, pixel in the newest keyframe, residual (1 and more: outlier;
            NaN: not found).
        masks: Outlines `(K, 2)` float32, pixels, of what is left out, by side.
        published_s: When it was published.
    """

    topic: str
    stamp_ns: int
    tracks: FloatArray32
    masks: Mapping[str, tuple[FloatArray32, ...]]
    published_s: float


@dataclass(frozen=True, slots=True)
class GraphView:
    """Which nodes of the suite are in the graph.

    Attributes:
        nodes: Their names.
        received_s: When that was looked up.
        lost: Messages that did not arrive at the feed, by topic.
    """

    nodes: frozenset[str]
    received_s: float
    lost: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class TimeLine:
    """Where the player of a recorded run is; a live run has none.

    Attributes:
        at_s: Seconds since its begin.
        end_s: Its length.
        playing: Whether it goes on.
        restarted: Whether it has gone back, so that what was shown does not hold any more.
    """

    at_s: float
    end_s: float
    playing: bool
    restarted: bool = False


Media = ImageSample | CloudSample | ElevationSample | TrackSample
"""What is large: the newest of each topic replaces what nobody has taken yet."""
MEDIA = (ImageSample, CloudSample, ElevationSample, TrackSample)
Update = Report | PoseSample | Status | Sampled | Media | GraphView | TimeLine
