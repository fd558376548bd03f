"""Trajectories of files, bags and sources beside their truth, as a page draws them."""

from __future__ import annotations

from pathlib import Path

from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.bag.bag import Bag
from sfr_loc_map.io.bag.files import is_bag
from sfr_loc_map.io.registry import read_truth
from sfr_loc_map.scoring.load import load_drive, load_estimates
from sfr_loc_map.topics import ESTIMATE


def load_trajectories(paths: list[Path], truth: Path | None) -> tuple[dict[str, Trajectory], Trajectory | None]:
    """Return the trajectories by the shortest names that differ, and the truth, None if no truth is given.

    Poses without stamps have those of the truth. Of a source without estimates the truth is returned.
    """
    file_names = [path.name for path in paths]
    poses: dict[str, Trajectory] = {}
    true_poses: Trajectory | None = None
    for path in paths:
        name = path.name if file_names.count(path.name) == 1 else str(path)
        is_source = path.is_dir()
        if is_bag(path):
            is_source = truth is None and not Bag(path).matches(ESTIMATE)
        if is_source:
            poses[name] = read_truth(path)
        elif truth is None:
            poses[name] = load_estimates(path).trajectory
        else:
            drive = load_drive(path, truth)
            poses[name] = drive.estimates.trajectory
            true_poses = true_poses or drive.truth
    if truth is not None and true_poses is None:
        true_poses = read_truth(truth)
    return poses, true_poses
