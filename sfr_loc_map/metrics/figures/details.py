"""Details of a score: the data of the plots, as columns that are decimated to a bounded size."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.metrics.figures.records import Record

Values = tuple[float | None, ...]  #: One entry per row; None if the value is undefined.
Integers = tuple[int, ...]


def named_columns(name: str, values: NDArray[np.floating]) -> dict[str, Values]:
    """Return numbers `(N,)` as a column with a name, or vectors `(N, d)` as columns `NAME 1` to `NAME d`."""
    if values.ndim == 1:
        return {name: column(values)}
    return {f"{name} {number}": column(each) for number, each in enumerate(values.T, 1)}


def column(values: NDArray[np.floating], digits: int | None = 9) -> Values:
    """Return numbers as a column, None if not finite; `digits` is the number of decimals, or None for no rounding."""
    numbers = np.asarray(values, np.float64)
    rounded = numbers if digits is None else np.round(numbers, digits)
    return tuple(number if math.isfinite(number) else None for number in rounded.tolist())


def check_lengths(columns: Iterable[Sequence[object]]) -> None:
    """Check that columns have the same length; ValueError if not."""
    if len({len(column) for column in columns}) > 1:
        raise ValueError("its columns differ in length")


class Columns(Record, frozen=True, kw_only=True):
    """A record whose tuples are the columns of one table; an empty column is unknown."""

    def __post_init__(self) -> None:
        """Check that all known columns have the same length; ValueError if not."""
        columns = [value for value in msgspec.structs.asdict(self).values() if isinstance(value, tuple)]
        for value in msgspec.structs.asdict(self).values():
            columns += value.values() if isinstance(value, dict) else ()
        check_lengths([column for column in columns if column])


class CallHistogram(Record, frozen=True, kw_only=True):
    """A histogram of the times of calls with logarithmic bins."""

    edges_s: tuple[float, ...]  #: Edges of the bins, one more than counts; empty without calls.
    counts: Integers  #: Calls in each bin.

    def __post_init__(self) -> None:
        """Check that there is one more edge than bins; ValueError if not."""
        if self.counts and len(self.edges_s) != len(self.counts) + 1:
            raise ValueError(f"{len(self.counts)} counts with {len(self.edges_s)} edges: one edge more is required")


class CallSeries(Columns, frozen=True, kw_only=True):
    """The calls in order; if there are many calls, the slowest call of each block."""

    slowest_of: int  #: Number of calls of a block.
    stamp_ns: Integers  #: Stamp of the pair.
    processing_time_s: Values  #: Wall-clock time.
    peak_rss_bytes: Values  #: Peak resident memory.
    state: tuple[str, ...]  #: State that the call reported.


class CallPlots(Record, frozen=True, kw_only=True):
    """Data of the plots of the calls of one kind."""

    histogram: CallHistogram  #: Histogram of the times.
    series: CallSeries  #: Times and memory by call.


class PathRows(Columns, frozen=True, kw_only=True):
    """Every n-th frame of the trajectory, in metres in DS."""

    every: int  #: n.
    stamp_ns: Integers  #: Stamps.
    travelled_m: Values  #: Length of the true path up to the frame.
    truth_x_m: Values  #: True position.
    truth_y_m: Values  #: True position.
    truth_z_m: Values  #: True position.
    estimate_x_m: Values  #: Estimated position.
    estimate_y_m: Values  #: Estimated position.
    estimate_z_m: Values  #: Estimated position.
    lost: tuple[bool, ...]  #: Whether the localiser was lost.
    degraded: tuple[bool, ...] = ()  #: Whether the pose was reported as degraded.
    sigma_x_m: Values = ()  #: Sigma of x from the published covariance; empty without a covariance.
    sigma_y_m: Values = ()  #: Sigma of y.
    sigma_z_m: Values = ()  #: Sigma of z.


NAMED_ERRORS = {
    "position": ("x_m", "y_m", "z_m"),
    "horizontal": ("x_m", "y_m"),
    "attitude": ("attitude_deg",),
    "heading": ("heading_deg",),
    "chord": ("chord_m",),
}
"""Columns of `SubTrajectoryRows` with the errors of a figure; the errors of other figures are in `others`."""


class SubTrajectoryRows(Columns, frozen=True, kw_only=True):
    """Every n-th sub-trajectory of one condition."""

    condition: str  #: Condition that ends the sub-trajectories.
    every: int  #: n.
    start_frame: Integers  #: Index of the first frame.
    end_frame: Integers  #: Index of the last frame.
    start_stamp_ns: Integers  #: Stamp of the first frame.
    end_stamp_ns: Integers  #: Stamp of the last frame.
    x_m: Values  #: Position error, DS.
    y_m: Values  #: Position error, DS.
    z_m: Values  #: Position error, DS.
    attitude_deg: Values  #: Attitude error.
    heading_deg: Values  #: Heading error, signed.
    chord_m: Values  #: Straight-line distance from start to end, estimate minus truth.
    along_m: Values  #: Position error along the true displacement.
    cross_m: Values  #: Position error across the true displacement, positive to the left.
    travelled_m: Values  #: Length of the true path from start to end.
    #: Errors of the other figures of sub-trajectories, in their unit: by figure, or a column for each direction of
    #: vectors, by figure and number of the direction (`NAME 1`).
    others: dict[str, Values] = {}

    def error_columns(self, figure: str) -> tuple[Values, ...]:
        """Return the errors of a figure, a column for each direction; empty if there are no errors of the figure."""
        if figure in NAMED_ERRORS:
            return tuple(getattr(self, name) for name in NAMED_ERRORS[figure])
        if figure in self.others:
            return (self.others[figure],)
        return tuple(values for name, values in self.others.items() if name.startswith(f"{figure} "))


def columns_of(conditions: Iterable[SubTrajectoryRows]) -> dict[str, list[Any]]:
    """Return the sub-trajectories of all conditions as columns of one table."""
    columns: dict[str, list[Any]] = {}
    for rows in conditions:
        count = len(rows.start_frame)
        for name, values in (msgspec.structs.asdict(rows) | rows.others).items():
            if name != "others":
                of_all = name in ("condition", "every")
                columns.setdefault(name, []).extend([values] * count if of_all else values)
    return columns


class ErrorRows(Record, frozen=True, kw_only=True):
    """All errors of one figure over one condition, for tolerance bounds; neither decimated nor rounded."""

    figure: str  #: Figure.
    condition: str  #: Condition that ends the sub-trajectories.
    errors: tuple[Values, ...]  #: A column for each direction, in the unit of the figure.

    def __post_init__(self) -> None:
        """Check that all directions have the same number of errors; ValueError if not."""
        check_lengths(self.errors)


class TrajectoryDetails(Record, frozen=True, kw_only=True):
    """Data of the plots of the trajectory."""

    path: PathRows | None = None  #: Frames; null in the report of a run in progress, which publishes them as messages.
    sub_trajectories: tuple[SubTrajectoryRows, ...]  #: Sub-trajectories of each condition.


class PointRows(Columns, frozen=True, kw_only=True):
    """Every n-th point of the cloud that has a ground truth."""

    x_m: Values  #: Position in LM.
    y_m: Values  #: Position in LM.
    z_m: Values  #: Position in LM.
    error_m: Values  #: Distance from the true point.
    range_m: Values  #: Distance of the true point from the left optical centre.


class ErrorImage(Record, frozen=True, kw_only=True):
    """The mean point error of blocks of pixels of one pair."""

    pair: int  #: Index of the pair.
    block_px: int  #: Width and height of a block, px.
    error_0p1mm: tuple[Integers, ...]  #: Rows of blocks, in units of 0.1 mm; -1 without a point.


class Triangulation(Record, frozen=True, kw_only=True):
    """Parameters of the triangulation error Z^2 d / (f b) for the depth Z and the disparity error d."""

    focal_px: float  #: Focal length f.
    baseline_m: float  #: Baseline b.


class MapDetails(Record, frozen=True, kw_only=True):
    """Data of the plots of the map."""

    cloud: PointRows  #: Points.
    error_images: tuple[ErrorImage, ...]  #: Mean point errors of each pair.
    triangulation: Triangulation  #: Parameters of the rig of the first pair.


class Details(Record, frozen=True, kw_only=True):
    """Data of all plots, as far as they are known."""

    calls: dict[str, CallPlots] = {}  #: Times and memory, by kind of call.
    trajectory: TrajectoryDetails | None = None  #: Data of the plots of the trajectory.
    map: MapDetails | None = None  #: Data of the plots of the map.
