"""Several trajectories side by side, and how far each is from the truth: what figures of paths are drawn from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sfr_loc_map.constants import NS_PER_S
from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.metrics.config import AlignedErrorConfig
from sfr_loc_map.metrics.trajectory.aligned_error import absolute_errors, aligned_poses

MOST_POINTS = 5000
"""Poses of a path that are drawn."""


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """One path.

    Attributes:
        name: Its name.
        seconds: `(N,)` since the first stamp of all.
        positions: `(N, 3)`, m.
        error_m: `(N,)` distance to the truth, None of the truth and without one.
        is_truth: Whether it is the truth.
    """

    name: str
    seconds: FloatArray
    positions: FloatArray
    error_m: FloatArray | None = None
    is_truth: bool = False


def curves_of(
    trajectories: Mapping[str, Trajectory], truth: Trajectory | None, config: AlignedErrorConfig
) -> list[Curve]:
    """Return trajectories as curves; with a truth it comes first, and each is aligned with it.

    Raises:
        MetricsError: If one has no pose, or no stamps near those of the truth.
    """
    given = [poses for poses in (*trajectories.values(), truth) if poses is not None and len(poses)]
    if len(given) < len(trajectories) + (truth is not None) or not given:
        raise MetricsError("a trajectory without poses cannot be drawn: leave it out")
    begin = min(int(poses.stamps_ns.min()) for poses in given)
    if truth is None:
        return [_curve(name, poses.stamps_ns, poses.positions, begin) for name, poses in trajectories.items()]
    curves = [_curve("truth", truth.stamps_ns, truth.positions, begin, is_truth=True)]
    for name, poses in trajectories.items():
        paired = aligned_poses(poses, truth, config)
        error_m = absolute_errors(paired).translation_m
        curves.append(_curve(name, paired.stamps_ns, paired.estimate.positions, begin, error_m))
    return curves


def _curve(
    name: str,
    stamps_ns: IntArray,
    positions: FloatArray,
    begin_ns: int,
    error_m: FloatArray | None = None,
    *,
    is_truth: bool = False,
) -> Curve:
    every = slice(None, None, max(1, -(-len(stamps_ns) // MOST_POINTS)))
    seconds = ((stamps_ns[every] - begin_ns) / NS_PER_S).astype(np.float64)
    return Curve(name, seconds, positions[every], None if error_m is None else error_m[every], is_truth)
