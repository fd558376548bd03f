"""Load the run to be scored from files or from data in memory."""

from __future__ import annotations

from collections.abc import Sequence

from sfr_loc_map.calls.call_stats import CallStats
from sfr_loc_map.geometry.arrays import IntArray
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.io.source_config import DEFAULT_SOURCE, SourceConfig, source_config
from sfr_loc_map.io.source_format import is_bag
from sfr_loc_map.metrics.figures.records import MethodKind, MethodRecord, TargetRecord
from sfr_loc_map.scoring.input_files import ReadFile, configuration_files, read_files
from sfr_loc_map.scoring.inputs import ExpectedPairs, InMemory, ItemUnderTest, Origin, Run, ScoreInputs
from sfr_loc_map.scoring.load_calls import read_calls, unbound_calls
from sfr_loc_map.scoring.load_drive import ReadDrive, ReadTruth, load_truth, read_drive
from sfr_loc_map.scoring.load_map import read_cloud


def load_run(
    inputs: ScoreInputs, fused: bool | None = None, in_memory: InMemory | None = None, *, command: str | None = None
) -> Run:
    """Read the files of a run. Poses without stamps get the stamps of the other trajectory, pose by pose.

    The calls of the run come from the bag of the estimate, from the files and from memory. Lost flags and covariances
    of an estimate come from its calls, and from its file or bag. Poses and cloud may be in memory. `fused` applies to
    clouds that do not declare whether they are fused. `command` is for provenance.

    InputError if a file is missing or invalid, if the calls are not of the estimate, or if the source lacks a pair of
    the cloud. ConfigError if `fused` contradicts the cloud. MetricsError if a pair of the cloud has no truth.
    """
    given = in_memory or InMemory()
    how = how_to_read(inputs)
    noted = _noted_files(inputs, how)  # before the files are read
    calls = read_calls(inputs, given)
    cloud, nav_stamps_ns = read_cloud(inputs, given.cloud, fused, calls.given)
    true: ReadTruth | None = None
    read: ReadDrive | None = None
    if (inputs.estimate or given.estimate) is not None and (inputs.truth or given.truth) is not None:
        true = load_truth(inputs.truth, given.truth, how)
        read = read_drive(inputs, given, true, calls)
    settings = {**_changed_reading(inputs, true, how), **calls.settings}
    origin = Origin(noted, given.hashes(), how.truth.changed_content, settings=settings, command=command)
    stats = [*calls.here, *(() if read is None else read.of_bag)]
    if nav_stamps_ns is None and true is not None:
        on_target = [] if calls.on_target is None else [calls.on_target]
        nav_stamps_ns = _nav_stamps_of(true.source, [*stats, *on_target])
    about = None if calls.target is None else calls.target.about
    has_images = true is not None and true.has_images
    unbound = unbound_calls(calls, has_drive=read is not None, has_cloud=cloud is not None, has_images=has_images)
    return Run(
        origin,
        stats,
        target=calls.target,
        drive=None if read is None else read.drive,
        cloud=cloud,
        item=ItemUnderTest(None if about is None else _method_of(about)),
        expected=ExpectedPairs(nav_stamps_ns=nav_stamps_ns),
        caveats=(*(() if cloud is None else cloud.caveats), *unbound),
    )


def _noted_files(inputs: ScoreInputs, how: SourceConfig) -> dict[str, ReadFile]:
    """Note the states of all files of a score by role, before they are read. Only the file of `how` was read before."""
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


def how_to_read(inputs: ScoreInputs) -> SourceConfig:
    """Return the configuration of the source of the truth: as given, or else from the file beside the source."""
    place = inputs.truth or inputs.map_truth
    if place is not None and inputs.config is None and (place.is_dir() or is_bag(place)):
        return source_config(place)
    return inputs.config or DEFAULT_SOURCE


def _changed_reading(inputs: ScoreInputs, true: ReadTruth | None, how: SourceConfig) -> dict[str, object]:
    """Return the settings that changed the reading of the source of the truth; empty for a file of poses.

    Extrinsics are not used without the images of a drive.
    """
    if true is not None and true.source is not None:
        return true.source.changed_reading
    place = inputs.truth or inputs.map_truth
    if place is None or not (place.is_dir() or is_bag(place)):
        return {}
    return {name: value for name, value in how.changed_reading.items() if not name.startswith("extrinsics.")}


def _nav_stamps_of(source: Source | None, stats: Sequence[CallStats]) -> IntArray | None:
    """Return the stamps of the mapping pairs of a source if there are calls of a mapper; otherwise None."""
    if source is None or source.nav is None or all(item.calls.is_localisation.all() for item in stats):
        return None
    return source.expected_nav_ns()


def _method_of(about: TargetRecord) -> MethodRecord:
    """Return the method from the description of the target."""
    return MethodRecord(name="candidate", version=about.candidate, kind=MethodKind.LIBRARY)
