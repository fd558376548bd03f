"""Definitions of the terms in the tables of a score."""

from __future__ import annotations

from collections.abc import Mapping

from sfr_loc_map.metrics.formulas import QUANTILES
from sfr_loc_map.tables.model import Cell, Column, Table

TERMS: Mapping[str, str] = {
    "sub-trajectory": "the part of the drive from a start to the frame at which the condition is met",
    "re-based": "the estimate is moved to the true pose at each start, so that errors before the start do not count",
    "position error": "estimated minus true position at the end, as a vector; the mean is the norm of the mean vector",
    "attitude error": "angle between the estimated and the true attitude at the end of a sub-trajectory",
    "heading error": "estimated minus true heading (about the vertical) at the end, signed",
    "chord error": "straight distance from start to end, estimated minus true; requires no attitudes",
    "fitted": "aligned by one rotation (about the vertical unless z is tilted) and one translation per drive",
    "figure": "the judged quantity, and the condition that ends each sub-trajectory",
    "mean": "mean over all sub-trajectories, map points or calls; for position the norm of the mean vector",
    "sigma": "standard deviation over all sub-trajectories, map points or calls",
    "mean + 3 sigma": "norm of the mean plus three standard deviations, the statistic that the specification limits",
    "95 % interval": "confidence interval that contains the true mean + 3 sigma in 95 of 100 such drives; it requires "
    "two independent sub-trajectories",
    "n": "number of sub-trajectories, map points or calls of the figure",
    "independent": "number of sub-trajectories divided by the mean number of overlapping sub-trajectories",
    "rmse": "root mean square of the norms of the errors",
    ", ".join(QUANTILES): "quantiles: this percentage of the norms of the errors is at most this large",
    "not enough data": "the figure is undefined, or computed from fewer values than the limits require",
    "DS": "the fixed world frame of the drive: x east, y north, z up",
    "LM": "the local map frame of the map coordinates: fixed to the ground, z up",
    "along, across": "in the direction of the true path, and to its left",
    "NEES": "squared error normalised by its covariance; equal to the number of components on average if consistent",
    "point error": "distance from a map point to the true point of its pixel",
    "distance to the nearest true point": "distance from a map point to any true point; at most the point error",
    "coverage": "fraction of the true points in the scored range that have a map point",
    "disparity error": "depth error converted to disparity, in pixels; it does not grow with range",
    "time": "duration of a call of the localiser or mapper, without transport and queueing",
    "first call": "reported separately, because it may include one-time initialisation",
    "peak memory": "largest resident memory of the process during a call",
    "above the idle process": "peak memory minus the memory that was resident before the item under test "
    "began its work",
    "value": "with a limit, the statistic to which the limit applies; otherwise the single number of a figure, such "
    "as a count, a fraction or a peak",
    "limit": "bound of the value from the limits file: for coverage a lower bound, otherwise an upper bound",
    "verdict": "pass if the value is within its limit, fail if it is not; incomplete if expected data are missing; not "
    "judged if estimate and ground truth contradict each other",
    "certain": "the 95 % interval lies on one side of the limit",
    "margin": "distance from the value to the limit; negative if the limit is missed",
    "missing": "images without an estimate; if the images are unknown, true poses without an estimate",
    "evident gaps": "fraction of the images without an estimate; if the images are unknown, fraction of the true path "
    "travelled in gaps of more than five median periods between estimates",
    "judged fraction": "fraction of images with an estimate and a true pose; if unknown, fraction of the true poses",
    "lost": "no pose could be estimated; scored with the last known pose",
    "degraded": "a pose was estimated, but a check failed; its covariance is inflated and a reason is reported",
}
"""Definitions of the terms in the tables."""


def glossary() -> Table:
    """Return the terms of the tables with their definitions."""
    rows = tuple((Cell.head(word), Cell(text)) for word, text in TERMS.items())
    return Table("words", "Words", (Column("word", words=True), Column("meaning", words=True)), rows)
