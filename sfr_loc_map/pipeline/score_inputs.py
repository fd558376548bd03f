"""What a score is made of, read from files: estimates, truth, and where they came from."""

from __future__ import annotations

import logging
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from sfr_loc_map import __version__
from sfr_loc_map.config import flatten
from sfr_loc_map.errors import ConfigError, InputError, SfrError
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.bag_files import is_bag
from sfr_loc_map.io.cloud_file import SUFFIXES as CLOUD_SUFFIXES
from sfr_loc_map.io.cloud_file import LoadedCloud, load_cloud
from sfr_loc_map.io.hashing import hash_path
from sfr_loc_map.io.trajectory_formats import FOREIGN, LoadedTrajectory, read_trajectory_file
from sfr_loc_map.metrics.association import Estimates
from sfr_loc_map.metrics.cloud_error import PairTruth, truths_of
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.metrics.score import InputFile, Provenance
from sfr_loc_map.pipeline.call_stats import CallStats

if TYPE_CHECKING:
    from sfr_loc_map.io.sequence import Source

_log = logging.getLogger(__name__)

IN_MEMORY = "(in memory)"
"""Path of an input that is no file."""


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


@dataclass(frozen=True, slots=True, eq=False)
class LoadedDrive:
    """Estimated and true poses as read.

    Attributes:
        estimates: Estimated poses.
        truth: True poses.
        notes: What the format of each file was found to be, one line each.
    """

    estimates: Estimates
    truth: Trajectory
    notes: tuple[str, ...] = ()


def load_drive(estimate: Path | Trajectory, truth: Path | Trajectory, stats: Sequence[CallStats] = ()) -> LoadedDrive:
    """Read estimated and true poses; poses without stamps get those of the other ones, pose by pose.

    Args:
        estimate: A file or bag, or poses in memory.
        truth: The same, or a data set.
        stats: Calls that may have given the estimates.

    Raises:
        InputError: If there are none, or poses without stamps are not as many as the other ones.
    """
    if not isinstance(truth, Path):
        true_poses = LoadedTrajectory.of(Path(IN_MEMORY), truth)
    elif _holds_source(truth):
        true_poses = LoadedTrajectory.of(truth, load_truth(truth))
    else:
        true_poses = read_trajectory_file(truth, "truth")
    if isinstance(estimate, Path) and is_bag(estimate):
        estimates = _bag_estimates(estimate)
        true_poses = true_poses.with_stamps_of(LoadedTrajectory.of(estimate, estimates.trajectory))
        loaded = [true_poses]
    else:
        read = (
            read_trajectory_file(estimate)
            if isinstance(estimate, Path)
            else LoadedTrajectory.of(Path(IN_MEMORY), estimate)
        )
        read, true_poses = read.with_stamps_of(true_poses), true_poses.with_stamps_of(read)
        estimates, loaded = estimates_of(read.trajectory, stats), [read, true_poses]
    notes = tuple(item.text for item in loaded if item.format in FOREIGN)
    return LoadedDrive(estimates, true_poses.trajectory, notes)


def _holds_source(path: Path) -> bool:
    """Tell whether a path is a bag or folder rather than a trajectory file."""
    return not path.is_file() or is_bag(path)


def load_estimates(path: Path, stats: Sequence[CallStats] = ()) -> Estimates:
    """Read estimated poses; lost flags and covariances come from the bag or from the statistics of the calls.

    Raises:
        InputError: If there are none.
    """
    return _bag_estimates(path) if is_bag(path) else estimates_of(read_trajectory_file(path).trajectory, stats)


def estimates_of(trajectory: Trajectory, stats: Sequence[CallStats] = ()) -> Estimates:
    """Return estimated poses with the lost flags and covariances of the calls that gave them."""
    stamps_ns = trajectory.stamps_ns
    for item in stats:
        if not item.localised_rows().keys().isdisjoint(stamps_ns.tolist()):
            states = item.lost_at(stamps_ns), item.degraded_at(stamps_ns)
            return Estimates.of(trajectory, *states, item.covariance_at(stamps_ns), item.steps_at(stamps_ns))
    if any(item.localised_rows() for item in stats):
        _log.warning("no call of the statistics has the stamp of an estimate: which poses are lost is not known")
    return Estimates.of(trajectory)


def _bag_estimates(path: Path) -> Estimates:
    from sfr_loc_map.pipeline.bag_estimates import bag_estimates  # the library of the bags is loaded for a bag only

    return bag_estimates(path)


def _open_source(path: Path) -> Source:
    from sfr_loc_map.io.registry import open_source  # files of trajectories need no images

    return open_source(path)


def load_truth(path: Path) -> Trajectory:
    """Read true poses of RB in DS from a trajectory file, a bag or a data set folder.

    Raises:
        InputError: If there are none.
    """
    if not _holds_source(path):
        return read_trajectory_file(path, "truth").trajectory
    if is_bag(path):
        from sfr_loc_map.pipeline.bag_estimates import bag_truth

        truth = bag_truth(path)
    else:
        source = _open_source(path)
        truth = None if source.loc is None else source.loc.ground_truth
    if truth is None or not len(truth):
        raise InputError(
            f"'{path}' has no true poses (groundtruth.csv, ground_truth/odometry): give a source with truth"
        )
    return truth


def load_scored_cloud(path: Path, fused: bool | None = None) -> LoadedCloud:
    """Read a cloud that is to be scored: one with pixels must say whether it is fused.

    Args:
        path: The file.
        fused: What the user says of a file that does not say so.

    Raises:
        InputError: If the file cannot be read, or neither says whether the cloud is fused.
        ConfigError: If the user says otherwise than the file.
    """
    return said_fused(load_cloud(path), fused, f"cloud '{path}'")


def said_fused(loaded: LoadedCloud, fused: bool | None, name: str) -> LoadedCloud:
    """Return a cloud that says whether it is fused.

    Args:
        loaded: The cloud.
        fused: What the user says of one that does not say so.
        name: Its name, for messages.

    Raises:
        InputError: If neither says whether the cloud is fused.
        ConfigError: If the user says otherwise than the cloud.
    """
    if loaded.cloud is None:
        return loaded
    said = loaded.cloud.fused
    if said is None and fused is None:
        raise InputError(
            f"{name} does not say whether it is fused: give --fused (one surface of several pairs) or "
            "--not-fused (each pair's own points); coverage is counted differently"
        )
    if said is not None and fused is not None and said != fused:
        option, word = ("--fused", "not fused") if fused else ("--not-fused", "fused")
        raise ConfigError(f"'{option}': {name} says that it is {word}; leave the option out")
    return replace(loaded, cloud=replace(loaded.cloud, fused=fused if said is None else said))


def load_map_truth(path: Path, stamps_ns: Sequence[int] | None = None) -> list[PairTruth]:
    """Read the truth of the mapping pairs of a source.

    Args:
        path: The source.
        stamps_ns: Pairs that are wanted, in their order; None for all.

    Raises:
        InputError: If the source has no mapping pairs, or one that is wanted is not there.
        MetricsError: If a pair has no truth.
    """
    nav = _open_source(path).nav
    if nav is None:
        raise InputError(f"'{path}' has no mapping pairs: a cloud is scored against a source with nav pairs and truth")
    if stamps_ns is None:
        return truths_of(list(nav.pairs()), nav.rig)
    pairs = {item.pair.stamp_ns: item for item in nav.pairs() if item.pair.stamp_ns in set(stamps_ns)}
    missing = [str(stamp_ns) for stamp_ns in stamps_ns if stamp_ns not in pairs]
    if missing:
        raise InputError(
            f"the cloud was made of pairs of stamps {', '.join(missing)}, which '{path}' does not have: give the "
            "source that it was made from"
        )
    return truths_of([pairs[stamp_ns] for stamp_ns in stamps_ns], nav.rig)


def camera_rig(truth: Path) -> StereoRig | None:
    """Return the rig of the localisation cameras of a source, None where it has none."""
    if not _holds_source(truth):
        return None
    try:
        loc = _open_source(truth).loc
    except SfrError:  # true poses alone, without cameras: whoever needs the images reports what is wrong with them
        return None
    return None if loc is None else loc.rig


def provenance(
    inputs: ScoreInputs, config: ScoreConfig, data: Mapping[str, str], in_memory: Mapping[str, str] | None = None
) -> Provenance:
    """Return what the score was made of: version, inputs with hashes, settings, host, time.

    Args:
        inputs: Files.
        config: Settings.
        data: Hash of the values of inputs by role (`truth`, `map_truth`).
        in_memory: Hash of inputs that are no file, by role.
    """
    named = {
        "estimate": inputs.estimate,
        "truth": inputs.truth,
        "cloud": inputs.cloud,
        "map_truth": inputs.map_truth,
        "target": inputs.target,
        **{f"stats_{number}": path for number, path in enumerate(inputs.stats)},
    }
    files = {}
    for name, path in named.items():
        if path is None:
            continue
        if name == "truth" and path.is_dir() and not is_bag(path):  # of the folder only the trajectory counts
            found = [item for item in (path / "groundtruth.csv", path / "loc" / "groundtruth.csv") if item.is_file()]
            path = found[0] if found else path
        files[name] = InputFile(path=str(path), sha256=hash_path(path), data_sha256=data.get(name))
    for name, sha256 in (in_memory or {}).items():
        files[name] = InputFile(path=IN_MEMORY, sha256=sha256, data_sha256=data.get(name))
    return Provenance(
        version=__version__,
        inputs=files,
        configuration=flatten(config),
        host={"machine": platform.machine(), "system": platform.system(), "python": platform.python_version()},
        time=datetime.now(UTC).isoformat(timespec="seconds"),
    )
