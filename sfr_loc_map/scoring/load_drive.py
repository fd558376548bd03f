"""Read the estimated and true poses of a run."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import NamedTuple

from sfr_loc_map import io  # `io` imports its readers of sources on first use; trajectory files require none
from sfr_loc_map.calls.call_files import stats_beside
from sfr_loc_map.calls.call_stats import CallStats
from sfr_loc_map.errors import InputError, SfrError
from sfr_loc_map.geometry.arrays import IntArray
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory, Truth
from sfr_loc_map.inputs import check_exists
from sfr_loc_map.io.sequence import Source, without_truth
from sfr_loc_map.io.source_config import DEFAULT_SOURCE, SourceConfig, source_config
from sfr_loc_map.io.source_format import is_bag
from sfr_loc_map.io.tables.loaded_trajectory import LoadedTrajectory
from sfr_loc_map.io.tables.trajectory_file import ESTIMATE_OPTION, TRUTH_OPTION, read_trajectory_file
from sfr_loc_map.io.truth.conversion import truth_of_rb
from sfr_loc_map.io.truth.recorded import RecordedTruth
from sfr_loc_map.metrics.frames.association import Estimates
from sfr_loc_map.scoring.bag_estimates import BagEstimate, read_bag_estimate
from sfr_loc_map.scoring.call_checks import CHECKED_PAIRS, check_estimate, other_images, stamps_with_images
from sfr_loc_map.scoring.inputs import IN_MEMORY, DriveToScore, InMemory, ScoreInputs
from sfr_loc_map.scoring.load_calls import RunCalls, estimates_of_calls
from sfr_loc_map.suite_names import Task


class ReadTruth(NamedTuple):
    """True poses for one or several estimates."""

    poses: LoadedTrajectory
    source: Source | None  #: Source of the images; None if the truth is only a trajectory.
    place: Path | None  #: Path that was given; None for true poses in memory.
    how: SourceConfig  #: How the truth was read.

    @property
    def has_images(self) -> bool:
        """Whether the truth is that of a source with images of a drive."""
        return self.source is not None and self.source.loc is not None


class ReadDrive(NamedTuple):
    """Result of `read_drive`."""

    drive: DriveToScore
    of_bag: Sequence[CallStats]  #: Calls in the bag of the estimate.


def load_truth(place: Path | None, given: Trajectory | None, how: SourceConfig) -> ReadTruth:
    """Return true poses with the source of their images: those of a file, bag or data set folder, or those in memory.

    `io.read_truth` reads the truth of bags, and the truth that `truth.source` names. This function reads other files,
    because their poses may have no stamps, and takes the truth of a data set folder from the opened source.
    """
    if place is None:
        assert given is not None  # by the caller
        return ReadTruth(LoadedTrajectory(Path(f"the truth {IN_MEMORY}"), given), None, place, how)
    check_exists(place, "give a file of poses, a ROS bag, or a data set folder")
    if is_bag(place) or how.truth.source:
        poses = LoadedTrajectory(place, io.read_truth(place, how))
        return ReadTruth(poses, _images_beside(place, how), place, how)
    if place.is_file():
        return ReadTruth(read_trajectory_file(place, how.truth.columns, TRUTH_OPTION), None, place, how)
    source = io.open_source(place, how)
    if source.loc is None or source.loc.ground_truth is None:
        raise without_truth(place)
    return ReadTruth(LoadedTrajectory(place, source.loc.ground_truth), source, place, how)


def _images_beside(place: Path, how: SourceConfig) -> Source | None:
    """Return the source of the images of a bag or folder whose truth was read; None without images."""
    if is_bag(place) or not place.is_file():
        with suppress(SfrError):  # without images only the true poses are used
            return io.open_source(place, how)
    return None


def read_drive(inputs: ScoreInputs, given: InMemory, true: ReadTruth, calls: RunCalls) -> ReadDrive:
    """Read an estimate, or use that in memory, and combine it with the truth."""
    bag = _read_bag(inputs.estimate, calls.here)
    of_bag = [] if bag is None else bag.all_calls
    found = _read_estimate(inputs, given.estimate, bag)
    caveats = [*_without_stamps(found, true.poses)]
    if found.by_index:
        found = found.with_stamps_of(true.poses)
    caveats += check_estimate(found.trajectory, calls.of_estimate)
    caveats += _caveats_about_images(inputs, calls, true)
    caveats += _caveats_about_truth(true, inputs.estimate)
    here = [*calls.here, *of_bag]
    estimates = estimates_of_calls(found.trajectory, here, calls.on_target, found.covariance)
    return ReadDrive(replace(_drive_of(found, estimates, true), caveats=tuple(caveats)), of_bag)


def _caveats_about_images(inputs: ScoreInputs, calls: RunCalls, true: ReadTruth) -> Iterator[str]:
    """Compare the images of the calls of files with those of the source of the truth, if the source has images.

    Yield a caveat if the images cannot be read, or if the calls were made on other images.
    """
    source, named = true.source, stamps_with_images(calls.given)
    if source is None or source.loc is None or not named or not inputs.has_images_of_run:
        return
    problem = ""
    pairs: list[StereoPair] = []
    if named.isdisjoint(source.loc.stamps_ns):
        problem = "the source has no pair with the stamp of a call"
    else:
        try:
            pairs = [*islice((pair for pair in source.loc.pairs() if pair.stamp_ns in named), CHECKED_PAIRS)]
        except SfrError as error:
            problem = str(error)
    if problem:
        yield f"the images of the calls (--stats) were not compared with those of '{source.path}': {problem}"
    yield from other_images(calls.given, pairs, source.path)


def _caveats_about_truth(true: ReadTruth, estimate: Path | None) -> Iterator[str]:
    """Yield a caveat if the file of the true poses is the output of a run, or if a configuration beside it is not used.

    A file of poses is read without the `sfr.yaml` beside it, because this file may describe another source.
    """
    place = true.how.truth.file or true.place
    if place is None or not place.is_file() or is_bag(place):
        return
    calls = stats_beside(place)
    are_of_estimate = estimate is not None and estimate != place and stats_beside(estimate) == calls
    if calls.is_file() and not are_of_estimate:
        yield (
            f"the truth '{place}' is the output of a run, because the calls of this run are beside it ('{calls}'): the "
            "figures state the difference of two estimates (the estimate is the first argument)"
        )
    with suppress(SfrError):  # of a configuration that is not used
        beside = source_config(place)
        path = beside.configuration.path
        if path is not None and true.how.configuration.path is None and beside.truth.changed_content:
            settings = ", ".join(beside.truth.changed_content)
            yield (
                f"'{path}' beside the truth sets {settings}, but was not used for a file of poses: if these settings "
                f"describe the truth, give --config {path}"
            )


def _without_stamps(*trajectories: LoadedTrajectory) -> Iterator[str]:
    """Yield a caveat for each trajectory without stamps, whose poses are assigned by their numbers."""
    for poses in trajectories:
        if poses.by_index:
            yield (
                f"'{poses.path}' has no stamps: its poses were assigned to those of the other trajectory by their "
                "numbers, so that a delay of the estimate is not measured"
            )


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
            "once. Without --stats, EST.stats.csv is read if it exists: move this file, or convert the poses with sfr "
            "convert"
        )
    return bag


def _read_estimate(inputs: ScoreInputs, given: Trajectory | None, bag: BagEstimate | None) -> LoadedTrajectory:
    """Return the estimated poses of a bag that was read, or read those of a file, or use those in memory."""
    if inputs.estimate is None:
        assert given is not None  # by the caller
        return LoadedTrajectory(Path(f"the estimate {IN_MEMORY}"), given)
    if bag is not None:
        return LoadedTrajectory(inputs.estimate, bag.trajectory, covariance=bag.covariance)
    return read_trajectory_file(inputs.estimate, inputs.columns, ESTIMATE_OPTION)


def _drive_of(found: LoadedTrajectory, estimates: Estimates, true: ReadTruth) -> DriveToScore:
    """Return the estimate and the truth as a drive; missing stamps of true poses are those of the estimate."""
    poses = true.poses.with_stamps_of(found) if true.poses.by_index else true.poses
    declared = _as_declared(poses, true.place, true.how)
    rig, images = _images_of(true.source)
    notes = tuple(item.text for item in (found, declared) if item.is_announced)
    return DriveToScore(estimates, declared.trajectory, rig, images, notes)


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
