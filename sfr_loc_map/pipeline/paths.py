"""Trajectories of files for `sfr plot`."""

from __future__ import annotations

from pathlib import Path

from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.bag_files import is_bag
from sfr_loc_map.metrics.aligned_error import Curve, curves_of
from sfr_loc_map.metrics.config import AlignedErrorConfig
from sfr_loc_map.pipeline.score_inputs import load_drive, load_estimates, load_truth


def load_curves(paths: list[Path], truth: Path | None, config: AlignedErrorConfig) -> list[Curve]:
    """Read trajectories (files, bags, data set folders with truth) as curves.

    Args:
        paths: The trajectories.
        truth: The truth, None without one.
        config: Alignment and association of each with the truth.

    Raises:
        InputError: If one cannot be read.
        MetricsError: If one has no stamps near those of the truth.
    """
    names = [path.name if sum(path.name == other.name for other in paths) == 1 else str(path) for path in paths]
    if truth is None:
        return curves_of(dict(zip(names, map(_poses, paths), strict=True)), None, config)
    if any(_is_source(path) for path in paths):
        pairs = [(_poses(path), load_truth(truth)) for path in paths]
    else:
        read = [load_drive(path, truth) for path in paths]
        pairs = [(item.estimates.trajectory, item.truth) for item in read]
    return curves_of(dict(zip(names, (pair[0] for pair in pairs), strict=True)), pairs[0][1], config)


def _is_source(path: Path) -> bool:
    return path.is_dir() and not is_bag(path)


def _poses(path: Path) -> Trajectory:
    return load_truth(path) if _is_source(path) else load_estimates(path).trajectory
