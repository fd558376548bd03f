"""Loads the run to be scored from files or from data in memory."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from sfr_loc_map import io  # readers of sources are loaded when called, because files of trajectories require no images
from sfr_loc_map.calls.call_files import load_call_stats
from sfr_loc_map.calls.call_stats import CallStats, estimates_of, united, with_stamps_of_poses
from sfr_loc_map.errors import ConfigError, InputError, SfrError
from sfr_loc_map.geometry.arrays import IntArray
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory, Truth
from sfr_loc_map.inputs import read_text, refusing
from sfr_loc_map.io.bag.files import is_bag
from sfr_loc_map.io.clouds.cloud_file import LoadedCloud, load_cloud
from sfr_loc_map.io.sequence import Source, without_truth
from sfr_loc_map.io.source_config import DEFAULT_SOURCE, SourceConfig
from sfr_loc_map.io.source_settings import source_config
from sfr_loc_map.io.tables.trajectory_file import ESTIMATE_OPTION, TRUTH_OPTION, LoadedTrajectory, read_trajectory_file
from sfr_loc_map.io.truth.conversion import truth_of_rb
from sfr_loc_map.io.truth.read import truth_of_path
from sfr_loc_map.io.truth.recorded import RecordedTruth
from sfr_loc_map.metrics.errors.cloud_error import PairTruth, truths_of
from sfr_loc_map.metrics.frames.association import UPPER, Estimates
from sfr_loc_map.metrics.table.records import MethodKind, MethodRecord, TargetRecord
from sfr_loc_map.scoring.bag_estimates import BagEstimate, read_bag_estimate
from sfr_loc_map.scoring.call_checks import check_one_estimate, check_one_method
from sfr_loc_map.scoring.input_files import ReadFile, configuration_files, read_files
from sfr_loc_map.scoring.inputs import (
    IN_MEMORY,
    CloudToScore,
    DriveToScore,
    InMemory,
    Origin,
    Run,
    ScoreInputs,
    TargetCalls,
)
from sfr_loc_map.suite_names import Task
from sfr_loc_map.topics import ESTIMATE

_log = logging.getLogger(__name__)
TARGET_SCHEMA = "sfr-target/1"


class _Calls(NamedTuple):
    """The calls of a run, except those of a bag."""

    given: list[CallStats]  #: Calls of files.
    here: list[CallStats]  #: Calls on this host: those of files and in memory.
    target: TargetCalls | None  #: Calls on a target.

    @property
    def on_target(self) -> CallStats | None:
        """The calls on a target."""
        return None if self.target is None else self.target.calls

    @property
    def of_estimate(self) -> list[CallStats]:
        """The calls that must belong to the estimate: those of this host, and of a target of the same run."""
        if self.target is None or self.target.other_run is not None:
            return self.here
        return [*self.here, self.target.calls]


class _ReadDrive(NamedTuple):
    """What is read of a drive."""

    drive: DriveToScore
    of_bag: Sequence[CallStats]  #: Calls in the bag of the estimate.
    source: Source | None  #: Source of the images and of the truth; None if the truth is only a trajectory.


def load_run(
    inputs: ScoreInputs, fused: bool | None = None, in_memory: InMemory | None = None, *, command: str | None = None
) -> Run:
    """Read the files of a run. Poses without stamps get the stamps of the other trajectory, pose by pose.

    The calls of the run are those of the bag of the estimate, of the files and in memory. Lost flags and covariances of
    an estimate come from its calls and its bag. Poses and cloud may be in memory. `fused` applies to clouds that do not
    declare whether they are fused. `command` is for provenance.
    """
    given = in_memory or InMemory()
    how = _how_to_read(inputs)
    origin = Origin(_noted_files(inputs, how), given.hashes(), command=command)  # before the files are read
    calls = _read_calls(inputs, given)
    cloud, nav_stamps_ns = _read_cloud(inputs, given.cloud, fused)
    read = _read_drive(inputs, given, how, calls)
    stats = [*calls.here, *(() if read is None else read.of_bag)]
    if nav_stamps_ns is None and read is not None:
        on_target = [] if calls.on_target is None else [calls.on_target]
        nav_stamps_ns = _nav_stamps_of(read.source, [*stats, *on_target])
    about = None if calls.target is None else calls.target.about
    return Run(
        origin,
        stats,
        given_stats=calls.given,
        target=calls.target,
        drive=None if read is None else read.drive,
        cloud=cloud,
        method=None if about is None else _method_of(about),
        nav_stamps_ns=nav_stamps_ns,
    )


def _noted_files(inputs: ScoreInputs, how: SourceConfig) -> dict[str, ReadFile]:
    """Note the states of all files of a score by role, before they are read. Only `how` was read before."""
    stats = {f"stats_{number}": path for number, path in enumerate(inputs.stats)}
    return read_files(
        {
            "estimate": inputs.estimate,
            "truth": inputs.truth,
            "cloud": inputs.cloud,
            "map_truth": inputs.map_truth,
            "target": inputs.target,
            "target_about": inputs.target_about,
            "limits": inputs.limits,
            **configuration_files(how),
            **stats,
        }
    )


def _read_calls(inputs: ScoreInputs, given: InMemory) -> _Calls:
    """Read the calls of files, which must come from the method of the calls in memory."""
    of_files = [load_call_stats(path) for path in inputs.stats]
    here = [*of_files, *given.calls]
    on_target = None if inputs.target is None else load_call_stats(inputs.target, needed="processing_time_s")
    check_one_method(here, on_target)
    if on_target is None:
        return _Calls(of_files, here, None)
    about = None if inputs.target_about is None else load_target(inputs.target_about)
    name = (inputs.target_name or "target") if about is None else (about.board or "an unnamed board")
    return _Calls(of_files, here, TargetCalls(on_target, name, about, inputs.target_run))


def _method_of(about: TargetRecord) -> MethodRecord:
    """Return the method from the description of the target."""
    return MethodRecord(name="candidate", version=about.candidate, kind=MethodKind.LIBRARY)


def _read_cloud(
    inputs: ScoreInputs, given: PointCloud | None, fused: bool | None
) -> tuple[CloudToScore | None, IntArray | None]:
    """Read a cloud, or use that in memory; also the truth of its pairs, and the stamps of all pairs of the source."""
    if inputs.map_truth is None or (inputs.cloud or given) is None:
        return None, None
    if inputs.cloud is not None:
        loaded, name = load_cloud(inputs.cloud), f"cloud '{inputs.cloud}'"
    else:
        assert given is not None  # as checked above
        loaded, name = LoadedCloud(given.xyz.astype(np.float64), given), "the cloud"
    loaded = with_fusion_flag(loaded, fused, name)
    stamps_ns = None if loaded.cloud is None else loaded.cloud.pair_stamps_ns
    truths, nav_stamps_ns = load_map_truth(inputs.map_truth, stamps_ns, inputs.config)
    if truths:
        loaded = loaded.of_images(truths[0].rig.width, truths[0].rig.height, name)
    return CloudToScore(loaded, truths), nav_stamps_ns


def _how_to_read(inputs: ScoreInputs) -> SourceConfig:
    """Return the configuration of the source of the truth: the given one, or else the one beside the source."""
    place = inputs.truth or inputs.map_truth
    if place is not None and inputs.config is None and (place.is_dir() or is_bag(place)):
        return source_config(place)
    return inputs.config or DEFAULT_SOURCE


def _read_truth(
    place: Path | None, truth: Trajectory | None, how: SourceConfig
) -> tuple[LoadedTrajectory, Source | None]:
    """Read true poses of a file, bag or data set folder, or use those in memory; return also the source of images."""
    if place is None:
        assert truth is not None  # by the caller
        return LoadedTrajectory(Path(IN_MEMORY), truth), None
    if is_bag(place) or how.truth.source:
        true, opened = LoadedTrajectory(place, truth_of_path(place, how.truth, how.remap)), None
        if is_bag(place) or not place.is_file():
            with suppress(SfrError):  # without images only the true poses are used
                opened = io.open_source(place, how)
        return true, opened
    if place.is_file():
        return read_trajectory_file(place, how.truth.columns, TRUTH_OPTION), None
    source = io.open_source(place, how)
    if source.loc is None or source.loc.ground_truth is None:
        raise without_truth(place)
    return LoadedTrajectory(place, source.loc.ground_truth), source


def _read_bag(path: Path | None, stats: Sequence[CallStats]) -> BagEstimate | None:
    """Read the estimate of a bag; None for another file. InputError if a localiser has calls in the bag and in files.

    A call that is in both would count twice.
    """
    if path is None or not is_bag(path):
        return None
    bag = read_bag_estimate(path)
    if bag.calls is not None and any(item.has_task(Task.LOCALISATION) for item in stats):
        raise InputError(
            f"bag '{path}' has the calls of its localiser, and --stats has calls of a localiser, too: give the calls "
            "once; --stats EST.stats.csv is the default if the file exists: move the file, or convert the poses with "
            "sfr convert"
        )
    return bag


def _read_drive(inputs: ScoreInputs, given: InMemory, how: SourceConfig, calls: _Calls) -> _ReadDrive | None:
    """Read estimate and truth, or use those in memory; None if one of both is not given."""
    if (inputs.truth or given.truth) is None or (inputs.estimate or given.estimate) is None:
        return None
    true, source = _read_truth(inputs.truth, given.truth, how)
    bag = _read_bag(inputs.estimate, calls.here)
    if bag is None:
        found, estimates = _read_estimate(inputs, given.estimate, true, calls)
    else:
        found, estimates = _estimate_of_bag(bag, inputs, calls)
    drive = _drive_of(found, estimates, true, source, inputs.truth, how)
    return _ReadDrive(drive, () if bag is None else bag.all_calls, source)


def _estimate_of_bag(bag: BagEstimate, inputs: ScoreInputs, calls: _Calls) -> tuple[LoadedTrajectory, Estimates]:
    """Return the estimated poses of a bag with the states of its calls, or of the given calls."""
    assert inputs.estimate is not None  # the path of the bag
    check_one_estimate(bag.trajectory, calls.of_estimate)
    found = calls_of_poses(bag.trajectory, [*calls.here, *bag.all_calls], calls.on_target)
    return LoadedTrajectory(inputs.estimate, bag.trajectory), estimates_of(bag.trajectory, found, bag.covariance)


def _read_estimate(
    inputs: ScoreInputs, given: Trajectory | None, true: LoadedTrajectory, calls: _Calls
) -> tuple[LoadedTrajectory, Estimates]:
    """Read the estimated poses of a file, or use those in memory; missing stamps are those of the truth."""
    if inputs.estimate is not None:
        found = read_trajectory_file(inputs.estimate, inputs.columns, ESTIMATE_OPTION)
    else:
        assert given is not None  # by the caller
        found = LoadedTrajectory(Path(IN_MEMORY), given)
    if found.by_index:
        found = found.with_stamps_of(true)
    check_one_estimate(found.trajectory, calls.of_estimate)
    estimates = estimates_of_calls(found.trajectory, calls.here, calls.on_target)
    if found.covariance is not None and estimates.covariance is None:
        estimates = replace(estimates, covariance=found.covariance[:, *UPPER])
    return found, estimates


def _drive_of(
    found: LoadedTrajectory,
    estimates: Estimates,
    true: LoadedTrajectory,
    source: Source | None,
    place: Path | None,
    how: SourceConfig,
) -> DriveToScore:
    """Return the estimate and the truth as a drive; missing stamps of true poses are those of the estimate."""
    if true.by_index:
        true = true.with_stamps_of(found)
    true = _as_declared(true, place, how)
    rig, images = _images_of(source)
    notes = tuple(item.text for item in (found, true) if item.is_announced)
    return DriveToScore(estimates, true.trajectory, rig, images, notes)


def _as_declared(true: LoadedTrajectory, place: Path | None, how: SourceConfig) -> LoadedTrajectory:
    """Return true poses as the configuration declares them.

    The configuration is already applied to a `Truth`, except for a configured standard deviation. Poses of a file or in
    memory are checked even if the configuration declares nothing about the truth.
    """
    poses = true.trajectory
    if isinstance(poses, Truth):
        sigma_m, sigma_deg = how.truth.sigma_m or poses.sigma_m, how.truth.sigma_deg or poses.sigma_deg
        return replace(true, trajectory=replace(poses, sigma_m=sigma_m, sigma_deg=sigma_deg))
    if how.truth == DEFAULT_SOURCE.truth and place is not None and not place.is_file():
        return true
    return replace(true, trajectory=truth_of_rb(RecordedTruth(poses, true.text), how.truth))


def _images_of(source: Source | None) -> tuple[StereoRig | None, IntArray | None]:
    """Return the rig and the stamps of the localisation pairs of a source; None if unknown."""
    if source is None or source.loc is None:
        return None, None
    with suppress(InputError):  # raised without a complete pair
        return source.loc.rig, source.expected_loc_ns()
    return source.loc.rig, None


def _nav_stamps_of(source: Source | None, stats: Sequence[CallStats]) -> IntArray | None:
    """Return the stamps of the mapping pairs of a source if there are calls of a mapper; otherwise None."""
    if source is None or source.nav is None or all(item.calls.is_localisation.all() for item in stats):
        return None
    return source.expected_nav_ns()


def load_target(path: Path) -> TargetRecord:
    """Read the description of a target; raise InputError if it does not have the format of the harness."""
    with refusing(f"target '{path}' cannot be read", "give the file that the harness wrote"):
        content = msgspec.json.decode(read_text(path), type=dict[str, Any])
        if content.pop("schema", None) != TARGET_SCHEMA:
            raise ValueError(f"no schema {TARGET_SCHEMA}")
        return msgspec.convert(content, TargetRecord)


def load_drive(estimate: Path, truth: Path) -> DriveToScore:
    """Read estimated and true poses of files."""
    drive = load_run(ScoreInputs(estimate=estimate, truth=truth)).drive
    assert drive is not None  # both files are given
    return drive


def load_estimates(path: Path) -> Estimates:
    """Read estimated poses; lost flags and covariances are those of a bag, and unknown in another file."""
    if not is_bag(path):
        return Estimates.of(read_trajectory_file(path).stamped)
    bag = read_bag_estimate(path)
    return estimates_of(bag.trajectory, bag.calls, bag.covariance)


def estimates_of_calls(
    trajectory: Trajectory, stats: Sequence[CallStats] = (), target: CallStats | None = None
) -> Estimates:
    """Return estimated poses with the lost flags and covariances of their calls."""
    calls = calls_of_poses(trajectory, stats, target)
    return Estimates.of(trajectory) if calls is None else estimates_of(trajectory, calls)


def calls_of_poses(
    trajectory: Trajectory, stats: Sequence[CallStats] = (), target: CallStats | None = None
) -> CallStats | None:
    """Return the calls of an estimate; None, with a warning if there are calls, if no call has the stamp of a pose.

    The calls are those of all files of this host. If these contain no call of a pose, the calls of the target are used.
    """
    of_target = [] if target is None or not target.has_stamps else [target]
    for items in (stats, of_target):
        if own := [item for item in items if _has_call_of_pose(item, trajectory)]:
            return united(own)
    if any(len(item.localised_ns) for item in (*stats, *of_target)):
        _log.warning("no call of the statistics has the stamp of an estimate: the lost poses are unknown")
    return None


def _has_call_of_pose(stats: CallStats, trajectory: Trajectory) -> bool:
    localised_ns = with_stamps_of_poses(stats, trajectory.stamps_ns).localised_ns
    return bool(np.isin(localised_ns, trajectory.stamps_ns).any())


def load_map_truth(
    path: Path, stamps_ns: Sequence[int] | None = None, config: SourceConfig | None = None
) -> tuple[list[PairTruth], IntArray]:
    """Read the truth of all mapping pairs of a source, or of those at given stamps; return also all stamps."""
    source = io.open_source(path, config)
    nav = source.nav
    if nav is None:
        raise InputError(
            f"'{path}' has no mapping pairs: to score a cloud, give a source that has mapping pairs with ground truth"
        )
    wanted = None if stamps_ns is None else set(stamps_ns)
    pairs: dict[int, PosedStereoPair] = {}
    every = list(source.missing_nav_ns)
    for item in nav.pairs():
        every.append(item.pair.stamp_ns)
        if wanted is None or item.pair.stamp_ns in wanted:
            pairs[item.pair.stamp_ns] = item
    missing = [str(stamp_ns) for stamp_ns in stamps_ns or () if stamp_ns not in pairs]
    if missing:
        raise InputError(
            f"the cloud was made from pairs with stamps {', '.join(missing)}, which '{path}' does not have: give the "
            "source of the cloud"
        )
    chosen = pairs.values() if stamps_ns is None else [pairs[stamp_ns] for stamp_ns in stamps_ns]
    return truths_of(list(chosen), nav.rig), np.array(every, np.int64)


def with_fusion_flag(loaded: LoadedCloud, fused: bool | None, name: str) -> LoadedCloud:
    """Return a cloud with a known fusion flag, unless its points have no pixels."""
    if loaded.cloud is None:
        return loaded
    said = loaded.cloud.fused
    if said is None and fused is None:
        raise InputError(
            f"{name} does not declare whether it is fused, which changes the coverage: give --fused (one surface of "
            "several pairs) or --not-fused (separate points of each pair)"
        )
    if said is not None and fused is not None and said != fused:
        option, word = ("--fused", "not fused") if fused else ("--not-fused", "fused")
        raise ConfigError(f"'{option}': {name} declares that it is {word}; omit the option")
    return replace(loaded, cloud=replace(loaded.cloud, fused=fused if said is None else said))


def load_trajectories(paths: list[Path], truth: Path | None) -> tuple[dict[str, Trajectory], Trajectory | None]:
    """Return the trajectories for a page by their shortest unique names, and the truth; None if there is no truth.

    Poses without stamps get the stamps of the truth. For a source without estimates, its truth is returned.
    """
    file_names = [path.name for path in paths]
    poses: dict[str, Trajectory] = {}
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
            drive = load_drive(path, truth)
            poses[name] = drive.estimates.trajectory
            true_poses = true_poses or drive.truth
    if truth is not None and true_poses is None:
        true_poses = io.read_truth(truth)
    return poses, true_poses
