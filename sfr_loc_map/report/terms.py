"""What the figures of the report are, each in one sentence; a table shows those that it needs below itself."""

from __future__ import annotations

from collections.abc import Mapping

TERMS: Mapping[str, str] = {
    "sub-trajectory": "the part of the drive from a start to where the condition is met: so many metres, seconds or "
    "frames later; starts follow each other at a fixed number of frames.",
    "re-based": "the estimate is placed on the true pose at the start of each sub-trajectory, so that its error at "
    "the end is what was added on the way.",
    "position error": "estimated less true position at the end of a sub-trajectory, as a vector; the mean is the "
    "length of the mean vector.",
    "attitude error": "angle between the estimated and the true attitude at the end of a sub-trajectory.",
    "heading error": "estimated less true heading (about the vertical) at the end of a sub-trajectory, with its sign.",
    "mean + 3 sigma": "size of the mean plus three standard deviations, over all sub-trajectories, map points or "
    "calls: what the specification limits.",
    "95 % interval": "range that holds the true mean + 3 sigma in 95 of 100 such drives.",
    "not enough data": "the figure is not defined, or made of fewer values than the limits ask for.",
    "DS": "the fixed world frame of the drive: x east, y north, z up.",
    "LM": "the local map frame: fixed to the ground, z up; coordinates of the map are in it.",
    "along, across": "in the direction of the true path, and to its left.",
    "NEES": "squared error divided by the variance that was estimated for it: if that is honest, the mean is near the "
    "number of components (expected).",
    "95 % of consistent ones": "range in which the mean NEES of an honest estimate lies in 95 of 100 cases.",
    "point error": "distance from a map point to the true point of its pixel.",
    "distance to the nearest true point": "distance from a map point to any true point; reads lower than point error.",
    "coverage": "share of the true points within the scored range that have a map point.",
    "disparity error": "the disparity, in pixels, that the error in depth amounts to; it does not grow with range.",
    "p50, p95, p99": "50, 95 or 99 of 100 values are not larger.",
    "time per call": "from the call of the localiser or mapper to its return, without transport and queues.",
    "first call": "shown apart, as it may pay for what later calls find done.",
    "peak": "largest resident memory of the process during a call.",
    "above the idle process": "the peak less what was resident after start and before the first call.",
    "certain": "the 95 % interval lies on one side of the limit.",
    "lost": "no pose could be estimated; scored with the last known one.",
    "degraded": "a pose with a larger covariance, and a reason.",
}


def terms(*names: str) -> tuple[tuple[str, str], ...]:
    """Return terms with their definitions.

    Raises:
        KeyError: If one has none.
    """
    return tuple((name, TERMS[name]) for name in names)
