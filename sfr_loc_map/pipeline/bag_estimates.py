"""Estimated and true poses of a bag, for a score."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.bag import ODOMETRY, TF, Bag
from sfr_loc_map.io.bag_poses import GROUND_TRUTH, read_odometry, read_trajectory
from sfr_loc_map.metrics.association import UPPER, Estimates, lost_by_covariance
from sfr_loc_map.pipeline.bag_calls import read_calls


def bag_estimates(path: Path) -> Estimates:
    """Read estimated poses of a bag, with lost flags, covariances and steps.

    Raises:
        InputError: If there are none.
    """
    bag = Bag(path)
    topic = bag.find("localisation/odometry", ODOMETRY)
    if topic is None and set(bag.topics.values()) <= {ODOMETRY, TF}:  # a trajectory that was converted, no drive
        topic = bag.find("ground_truth/odometry", ODOMETRY)
    if topic is None:
        raise InputError(
            f"bag '{path}' has no topic localisation/odometry: it has {', '.join(list(bag.topics)[:8])}; give a bag "
            "with estimates, or a TUM or csv file"
        )
    odometry = read_odometry(bag, topic)
    trajectory, covariance = odometry.trajectory, odometry.covariance[:, *UPPER]
    known = np.where(covariance.any(axis=1, keepdims=True), covariance, np.nan)
    lost = lost_by_covariance(covariance)
    calls, stamps_ns = read_calls(bag, topic), trajectory.stamps_ns
    stated = known if covariance.any() else None
    return Estimates.of(trajectory, lost, calls.degraded_at(stamps_ns), stated, calls.steps_at(stamps_ns))


def bag_truth(path: Path) -> Trajectory | None:
    """Read true poses of a bag, None where it has none."""
    return read_trajectory(Bag(path), GROUND_TRUTH)
