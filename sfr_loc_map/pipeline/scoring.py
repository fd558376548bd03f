"""From files to a score: trajectory, map, time, memory, verdicts, provenance."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from sfr_loc_map import __version__
from sfr_loc_map.config import flatten
from sfr_loc_map.constants import LOST_VARIANCE
from sfr_loc_map.errors import InputError, SfrError
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.bag import ODOMETRY, TF, Bag, is_bag
from sfr_loc_map.io.bag_poses import GROUND_TRUTH, read_odometry, read_trajectory
from sfr_loc_map.io.cloud_file import LoadedCloud, load_cloud
from sfr_loc_map.io.hashing import hash_path
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.trajectory_file import load_trajectory
from sfr_loc_map.metrics.association import Estimates
from sfr_loc_map.metrics.cloud_error import score_map, score_nearest
from sfr_loc_map.metrics.cloud_truth import PairTruth, truths_of
from sfr_loc_map.metrics.condition import Condition
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.metrics.convention_diagnosis import Diagnosis, diagnose
from sfr_loc_map.metrics.limits import Limits
from sfr_loc_map.metrics.resource_score import merge_parts, score_calls, score_target
from sfr_loc_map.metrics.results import build_score
from sfr_loc_map.metrics.trajectory_score import score_trajectory
from sfr_loc_map.pipeline.call_stats import CallStats, load_call_stats

CLOUD_SUFFIXES = (".ply", ".pcd", ".npz")
UPPER = np.triu_indices(6)


@dataclass(frozen=True, slots=True)
class ScoreInputs:
    """What a score is made of; what is None is left out.

    Attributes:
        estimate: Estimated trajectory (TUM, csv or bag).
        truth: True trajectory (TUM, csv, bag or data set folder).
        cloud: Cloud file.
        map_truth: Source with mapping pairs and their truth.
        stats: CSV files with the calls of localiser and mapper.
        target: CSV file with calls that were measured on a target.
        target_name: Name of the target.
    """

    estimate: Path | None = None
    truth: Path | None = None
    cloud: Path | None = None
    map_truth: Path | None = None
    stats: tuple[Path, ...] = ()
    target: Path | None = None
    target_name: str = ""

    @classmethod
    def of(cls, estimate: Path, truth: Path, stats: Sequence[Path] = ()) -> ScoreInputs:
        """Return the inputs of one estimate, a cloud by its ending or a trajectory, and its truth."""
        if estimate.suffix in CLOUD_SUFFIXES:
            return cls(cloud=estimate, map_truth=truth, stats=tuple(stats))
        return cls(estimate=estimate, truth=truth, stats=tuple(stats))


def score_files(
    inputs: ScoreInputs, config: ScoreConfig, limits: Limits | None = None, *, fused: bool | None = None
) -> dict[str, Any]:
    """Return the score of files.

    Args:
        inputs: Files.
        config: Settings; conditions that only the limits name are scored as well.
        limits: Limits to judge by.
        fused: Whether the cloud is fused, None to find out.

    Raises:
        SfrError: If a file cannot be read, or nothing can be scored.
    """
    config = with_conditions(config, limits)
    stats = [load_call_stats(path) for path in inputs.stats]
    parts: list[dict[str, Any]] = [score_calls(item.calls) for item in stats]
    if inputs.target is not None:
        calls = load_call_stats(inputs.target, needed="processing_time_s").calls
        parts.append(score_target(calls, inputs.target_name))
    if inputs.estimate is not None and inputs.truth is not None:
        estimates = load_estimates(inputs.estimate, stats)
        truth = load_truth(inputs.truth)
        parts.append(score_trajectory(estimates, truth, config.trajectory))
        parts.append(warnings(estimates.trajectory, truth, config, camera_place(inputs.truth)))
    if inputs.cloud is not None and inputs.map_truth is not None:
        cloud, truths = load_cloud(inputs.cloud), load_map_truth(inputs.map_truth)
        parts.append(score_cloud(cloud, truths, config, fused=fused))
    return build_score(merge_parts(*parts), limits=limits, provenance=provenance(inputs, config))


def warnings(
    estimate: Trajectory, truth: Trajectory, config: ScoreConfig, T_rb_left: Transform | None
) -> dict[str, list[str]]:
    """Return the part `warnings` of the score: one line if a mistake of convention explains the errors."""
    found = diagnose(estimate, truth, config.trajectory.association, T_rb_left).found
    return {} if found is None else {"warnings": [f"{found.sentence} (sfr doctor tells more)"]}


def camera_place(truth: Path) -> Transform | None:
    """Return `T_rb_left` of a source with localisation cameras, None where it is not known."""
    if truth.is_file() and not is_bag(truth):
        return None
    try:
        loc = open_source(truth).loc
    except SfrError:  # true poses alone, without cameras: whoever needs the pictures says what is wrong with them
        return None
    return None if loc is None or loc.rig.T_rb_sb is None else loc.rig.T_rb_left


def diagnose_files(estimate: Path, truth: Path, config: ScoreConfig) -> Diagnosis:
    """Return which single mistake of convention explains how the trajectories of two files disagree.

    Raises:
        InputError: If a file cannot be read.
    """
    association = config.trajectory.association
    return diagnose(load_estimates(estimate).trajectory, load_truth(truth), association, camera_place(truth))


def score_cloud(
    loaded: LoadedCloud, truths: Sequence[PairTruth], config: ScoreConfig, *, fused: bool | None = None
) -> dict[str, Any]:
    """Return the map parts of the score of a cloud, by pixels where it has them."""
    if loaded.cloud is None:
        return score_nearest(loaded.xyz, truths, config.map)
    return score_map(loaded.cloud, truths, config.map, fused=fused)


def with_conditions(config: ScoreConfig, limits: Limits | None) -> ScoreConfig:
    """Return the settings with the conditions that the limits name added at the end."""
    if limits is None:
        return config
    present = [Condition.parse(text) for text in config.trajectory.conditions]
    missing = tuple(c.setting for c in limits.conditions if c not in present)
    conditions = (*config.trajectory.conditions, *missing)
    return replace(config, trajectory=replace(config.trajectory, conditions=conditions))


def load_estimates(path: Path, stats: Sequence[CallStats] = ()) -> Estimates:
    """Read estimated poses; lost flags and covariances come from the bag or from the statistics of the calls.

    Raises:
        InputError: If there are none.
    """
    if is_bag(path):
        return _bag_estimates(path)
    trajectory = load_trajectory(path)
    stamps = set(trajectory.stamps_ns.tolist())
    for item in stats:
        if stamps & set(item.calls.stamps_ns.tolist()):
            stamps_ns = trajectory.stamps_ns
            return Estimates.of(trajectory, item.lost_at(stamps_ns), item.covariance_at(stamps_ns))
    return Estimates.of(trajectory)


def _bag_estimates(path: Path) -> Estimates:
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
    return Estimates.of(trajectory, lost_by_covariance(covariance), known if covariance.any() else None)


def lost_by_covariance(covariance: np.ndarray[Any, np.dtype[np.float64]]) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Return which covariances `(N, 21)` say that the pose is not known: 9999 on the whole diagonal."""
    diagonal = np.flatnonzero(UPPER[0] == UPPER[1])
    return np.asarray((covariance[:, diagonal] >= LOST_VARIANCE).all(axis=1))


def load_truth(path: Path) -> Trajectory:
    """Read true poses of RB in DS from a trajectory file, a bag or a data set folder.

    Raises:
        InputError: If there are none.
    """
    if path.is_file() and not is_bag(path):
        return load_trajectory(path)
    if is_bag(path):
        truth = read_trajectory(Bag(path), GROUND_TRUTH)
    else:
        source = open_source(path)
        truth = None if source.loc is None else source.loc.ground_truth
    if truth is None or not len(truth):
        raise InputError(
            f"'{path}' has no true poses (groundtruth.csv, ground_truth/odometry): give a source with truth"
        )
    return truth


def load_map_truth(path: Path) -> list[PairTruth]:
    """Read the truth of the mapping pairs of a source.

    Raises:
        InputError: If the source has no mapping pairs.
        MetricsError: If a pair has no truth.
    """
    nav = open_source(path).nav
    if nav is None:
        raise InputError(f"'{path}' has no mapping pairs: a cloud is scored against a source with nav pairs and truth")
    return truths_of(list(nav.pairs()), nav.rig)


def provenance(inputs: ScoreInputs, config: ScoreConfig) -> dict[str, Any]:
    """Return what the score was made of: version, inputs with hashes, settings, host, time."""
    named = {"estimate": inputs.estimate, "truth": inputs.truth, "cloud": inputs.cloud, "map_truth": inputs.map_truth}
    named["target"] = inputs.target
    named |= {f"stats_{number}": path for number, path in enumerate(inputs.stats)}
    return {
        "version": __version__,
        "inputs": {name: _input(name, path) for name, path in named.items() if path is not None},
        "configuration": {key: list(v) if isinstance(v, tuple) else v for key, v in flatten(config).items()},
        "host": {"machine": platform.machine(), "system": platform.system(), "python": platform.python_version()},
        "time": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def _input(name: str, path: Path) -> dict[str, str]:
    """Return name and hash of an input; of a data set folder that gives a true trajectory only that file counts."""
    if name == "truth" and path.is_dir() and not is_bag(path):
        found = [item for item in (path / "groundtruth.csv", path / "loc" / "groundtruth.csv") if item.is_file()]
        path = found[0] if found else path
    return {"path": str(path), "sha256": hash_path(path)}
