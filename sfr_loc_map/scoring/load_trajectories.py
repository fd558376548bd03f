"""Read trajectories without calls of files and without images, for pages and comparisons."""

from __future__ import annotations

from pathlib import Path

from sfr_loc_map import io  # `io` imports its readers of sources on first use; trajectory files require none
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.source_format import is_bag
from sfr_loc_map.io.tables.trajectory_file import read_trajectory_file
from sfr_loc_map.metrics.frames.association import Estimates
from sfr_loc_map.scoring.bag_estimates import read_bag_estimate
from sfr_loc_map.scoring.inputs import DriveToScore, InMemory, ScoreInputs
from sfr_loc_map.scoring.load import how_to_read
from sfr_loc_map.scoring.load_calls import RunCalls, estimates_of_calls
from sfr_loc_map.scoring.load_drive import ReadTruth, load_truth, read_drive
from sfr_loc_map.topics import ESTIMATE


def load_drive(estimate: Path, truth: Path) -> DriveToScore:
    """Read estimated and true poses of files."""
    return _drive_of(estimate, _truth_at(truth))


def _truth_at(path: Path) -> ReadTruth:
    return load_truth(path, None, how_to_read(ScoreInputs(truth=path)))


def _drive_of(estimate: Path, true: ReadTruth) -> DriveToScore:
    return read_drive(ScoreInputs(estimate=estimate), InMemory(), true, RunCalls()).drive


def load_estimates(path: Path) -> Estimates:
    """Read estimated poses with the covariances of their file or bag, and with the calls of the bag."""
    if is_bag(path):
        bag = read_bag_estimate(path)
        return estimates_of_calls(bag.trajectory, bag.all_calls, published=bag.covariance)
    found = read_trajectory_file(path)
    return estimates_of_calls(found.stamped, published=found.covariance)


def load_trajectories(paths: list[Path], truth: Path | None) -> tuple[dict[str, Trajectory], Trajectory | None]:
    """Return the trajectories for a page by their shortest unique names, and the truth; None if there is no truth.

    Poses without stamps get the stamps of the truth. For a source without estimates, its truth is returned.
    """
    paths = list(dict.fromkeys(paths))
    file_names = [path.name for path in paths]
    poses: dict[str, Trajectory] = {}
    true: ReadTruth | None = None  # read once for all estimates
    true_poses: Trajectory | None = None
    for path in paths:
        name = path.name if file_names.count(path.name) == 1 else str(path)
        is_source = path.is_dir()
        if is_bag(path):
            is_source = truth is None and not io.Bag(path).matches(ESTIMATE)
        if is_source:
            poses[name] = io.read_truth(path)
        elif truth is None:
            poses[name] = load_estimates(path).trajectory
        else:
            true = true or _truth_at(truth)
            drive = _drive_of(path, true)
            poses[name] = drive.estimates.trajectory
            true_poses = true_poses or drive.truth
    if truth is not None and true_poses is None:
        true_poses = io.read_truth(truth)
    return poses, true_poses
