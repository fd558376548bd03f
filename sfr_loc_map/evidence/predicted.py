"""Predicted error of a drive by source: the covariance of sub-trajectories, split into the errors of the steps.

The steps of an estimate (`metrics.trajectory.consistency`) separate errors that are independent from step to step,
noise of single poses, and errors that all steps share. The mean squares of these parts add up to the total. Errors that
the localiser does not model are missing: a wrong baseline, focal length, mounting or clock.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from enum import StrEnum

import numpy as np

from sfr_loc_map.evidence.localiser_runs import ComparedRun
from sfr_loc_map.evidence.paired_runs import sub_trajectories_of
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.transform import propagation
from sfr_loc_map.metrics.conditions import Condition
from sfr_loc_map.metrics.figures.rows import Figure, figure_row
from sfr_loc_map.metrics.frames.association import StampedPoses
from sfr_loc_map.metrics.trajectory.consistency import StepSums, sums_of_steps


class PredictedSource(StrEnum):
    """Sources of error that the steps of an estimate separate."""

    STEPS = "drift from step to step"
    NOISE = "noise of single poses"
    DISPARITY = "disparity error common to all steps"
    LENS = "lens error common to all steps"
    ALL = "all stated sources"


def predicted_rows(run: ComparedRun, condition: Condition) -> Iterator[Figure]:
    """Yield the root mean square error that a run predicts over the sub-trajectories of a condition, by source.

    Sub-trajectories with a degraded or lost pose are skipped, because their covariance describes an unobserved motion.
    """
    poses = run.estimates.trajectory
    if run.estimates.steps is None:
        return
    path = StampedPoses(poses.stamps_ns, poses.positions, poses.quats_xyzw)
    starts, ends = sub_trajectories_of(path, condition)
    unreliable = np.concatenate(([0], np.cumsum(run.estimates.unreliable)))
    sums = sums_of_steps(run.estimates, run.estimates.steps, np.unique(np.concatenate((starts, ends))))
    parts = [
        squares_by_source(sums[start], sums[end], poses.positions[end])
        for start, end in zip(starts.tolist(), ends.tolist(), strict=True)
        if sums[start].unknown_steps == sums[end].unknown_steps and unreliable[start] == unreliable[end + 1]
    ]
    if not parts:
        return
    means = {source: np.mean([part[source] for part in parts], axis=0) for source in parts[0]}
    means[PredictedSource.ALL] = np.sum(list(means.values()), axis=0)
    for source, (position_m2, attitude_rad2) in means.items():
        where = (condition.setting, source.value)
        yield figure_row("predicted", *where, n=len(parts), value=np.sqrt(position_m2))
        yield figure_row("predicted_share", *where, n=len(parts), value=position_m2 / means[PredictedSource.ALL][0])
        yield figure_row("predicted_attitude", *where, n=len(parts), value=np.degrees(np.sqrt(attitude_rad2)))


def squares_by_source(start: StepSums, end: StepSums, position: FloatArray) -> Mapping[PredictedSource, FloatArray]:
    """Return the variances `(2,)` of position, m^2, and attitude, rad^2, summed over the axes, by source.

    The first three systematic errors displace each step, like a disparity error. The other three rotate each step,
    like a lens error that varies over the image.
    """
    carry = propagation(position)
    systematic = carry @ (end.systematic - start.systematic)
    disparity, lens = systematic[:, :3], systematic[:, 3:]
    covariances = {
        PredictedSource.STEPS: carry @ (end.covariance - start.covariance) @ carry.T,
        PredictedSource.NOISE: carry @ (start.noise + end.noise) @ carry.T,
        PredictedSource.DISPARITY: disparity @ disparity.T,
        PredictedSource.LENS: lens @ lens.T,
    }
    variances = {source: covariance.diagonal() for source, covariance in covariances.items()}
    return {source: np.array([values[:3].sum(), values[3:].sum()]) for source, values in variances.items()}
