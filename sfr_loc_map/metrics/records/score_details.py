"""The part `details` of the score: the series that figures are drawn from, as columns, thinned to bounded size.

A column is a tuple with one entry a row; None where a value is undefined.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from sfr_loc_map.metrics.condition import Condition
from sfr_loc_map.metrics.modes import CallKind
from sfr_loc_map.metrics.records.columns import Columns
from sfr_loc_map.metrics.records.json_records import Key

Column = tuple[float | None, ...]
Integers = tuple[int, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class CallHistogram:
    """A histogram of the times of calls with logarithmic bins.

    Attributes:
        edges_s: Edges of the bins, one more than counts; empty if there was no call.
        counts: Calls in each bin.
    """

    edges_s: tuple[float, ...]
    counts: Integers

    def __post_init__(self) -> None:
        """Check that there is one more edge than there are bins.

        Raises:
            ValueError: If not.
        """
        if self.counts and len(self.edges_s) != len(self.counts) + 1:
            raise ValueError(f"{len(self.counts)} counts with {len(self.edges_s)} edges: one edge more is needed")


@dataclass(frozen=True, slots=True, kw_only=True)
class CallSeries(Columns):
    """The calls in order; of many the slowest of each block.

    Attributes:
        slowest_of: Calls of a block.
        stamp_ns: Stamp of the pair.
        processing_time_s: Wall-clock time.
        peak_rss_bytes: Peak resident memory.
        state: What the call said.
    """

    slowest_of: int
    stamp_ns: Integers
    processing_time_s: Column
    peak_rss_bytes: Column
    state: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class CallFigures:
    """What the figures of the calls of one kind are drawn from.

    Attributes:
        histogram: Of the times.
        series: Times and memory by call.
    """

    histogram: CallHistogram
    series: CallSeries


@dataclass(frozen=True, slots=True, kw_only=True)
class CallDetails:
    """The figures of calls by kind; None where there was none.

    Attributes:
        localisation: Pairs localised.
        mapping: Pairs mapped.
        fusion: Sets fused.
    """

    localisation: CallFigures | None = None
    mapping: CallFigures | None = None
    fusion: CallFigures | None = None

    def of(self, kind: CallKind) -> CallFigures | None:
        """Return the figures of the calls of a kind."""
        return {
            CallKind.LOCALISATION: self.localisation,
            CallKind.MAPPING: self.mapping,
            CallKind.FUSION: self.fusion,
        }[kind]


@dataclass(frozen=True, slots=True, kw_only=True)
class PathRows(Columns):
    """Every n-th frame of the trajectory; metres, DS.

    Attributes:
        every: n.
        stamp_ns: Stamps.
        travelled_m: Length of the truth's path up to the frame.
        truth_x_m: True position.
        truth_y_m: True position.
        truth_z_m: True position.
        estimate_x_m: Estimated position.
        estimate_y_m: Estimated position.
        estimate_z_m: Estimated position.
        lost: Whether the localiser was lost.
        degraded: Whether it had a reason to doubt the pose; empty in scores that do not know.
        sigma_x_m: Sigma of x by the covariance published; empty where none was.
        sigma_y_m: Sigma of y.
        sigma_z_m: Sigma of z.
    """

    every: int
    stamp_ns: Integers
    travelled_m: Column
    truth_x_m: Column
    truth_y_m: Column
    truth_z_m: Column
    estimate_x_m: Column
    estimate_y_m: Column
    estimate_z_m: Column
    lost: tuple[bool, ...]
    degraded: tuple[bool, ...] = ()
    sigma_x_m: Column = ()
    sigma_y_m: Column = ()
    sigma_z_m: Column = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class SubTrajectoryRows(Columns):
    """Every n-th sub-trajectory of one condition.

    Attributes:
        condition: What ends them.
        every: n.
        start_frame: Number of the first frame.
        end_frame: Number of the last frame.
        start_stamp_ns: Stamp of the first frame.
        end_stamp_ns: Stamp of the last frame.
        x_m: Position error, DS.
        y_m: Position error, DS.
        z_m: Position error, DS.
        attitude_deg: Attitude error.
        heading_deg: Heading error, with its sign.
        along_m: Position error along the true displacement.
        cross_m: Position error to the left of it.
        vertical_m: Position error along z of DS.
        travelled_m: Length of the truth's path from start to end.
    """

    condition: Condition
    every: int
    start_frame: Integers
    end_frame: Integers
    start_stamp_ns: Integers
    end_stamp_ns: Integers
    x_m: Column
    y_m: Column
    z_m: Column
    attitude_deg: Column
    heading_deg: Column
    along_m: Column
    cross_m: Column
    vertical_m: Column
    travelled_m: Column


@dataclass(frozen=True, slots=True, kw_only=True)
class TrajectoryDetails:
    """What the figures of the trajectory are drawn from.

    Attributes:
        path: Frames.
        sub_trajectories: One for each condition.
    """

    path: PathRows
    sub_trajectories: tuple[SubTrajectoryRows, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class PointRows(Columns):
    """Every n-th point of the cloud that has a truth.

    Attributes:
        x_m: Position in LM.
        y_m: Position in LM.
        z_m: Position in LM.
        error_m: Distance from the truth.
        range_m: Distance of the truth from the left optical centre.
    """

    x_m: Column
    y_m: Column
    z_m: Column
    error_m: Column
    range_m: Column


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorImage:
    """The mean point error of blocks of pixels of one pair.

    Attributes:
        pair: Number of the pair.
        block_px: Pixels of a block each way.
        error: Rows of blocks, tenths of a millimetre, -1 where there is no point.
    """

    pair: int
    block_px: int
    error: Annotated[tuple[Integers, ...], Key("error_0p1mm")]


@dataclass(frozen=True, slots=True, kw_only=True)
class Triangulation:
    """The numbers of the law of triangulation, error = Z^2 d / (f b) for a disparity error d.

    Attributes:
        focal_px: Focal length f.
        baseline_m: Baseline b.
    """

    focal_px: float
    baseline_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class MapDetails:
    """What the figures of the map are drawn from.

    Attributes:
        cloud: Points.
        error_images: One for each pair.
        triangulation: Of the first pair's rig.
    """

    cloud: PointRows
    error_images: tuple[ErrorImage, ...]
    triangulation: Triangulation


@dataclass(frozen=True, slots=True, kw_only=True)
class Details:
    """What figures are drawn from, as far as it is there.

    Attributes:
        calls: Times and memory.
        trajectory: Trajectory.
        map: Map.
    """

    calls: CallDetails | None = None
    trajectory: TrajectoryDetails | None = None
    map: MapDetails | None = None
