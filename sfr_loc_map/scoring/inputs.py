"""Inputs of a score: files, their content, and the conversion of the estimate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

from sfr_loc_map.calls.call_files import stats_beside
from sfr_loc_map.calls.call_stats import CallStats
from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import IntArray
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.clouds import cloud_file
from sfr_loc_map.io.clouds.cloud_file import LoadedCloud
from sfr_loc_map.io.source_config import SourceConfig
from sfr_loc_map.metrics.conventions.pose_convention import PoseConvention, converted_estimates
from sfr_loc_map.metrics.errors.cloud_error import PairTruth
from sfr_loc_map.metrics.frames.association import Estimates
from sfr_loc_map.metrics.table.records import ConventionRecord, ExternalScore, FindingRecord, MethodRecord, TargetRecord

TARGET_FILE, TARGET_RESULTS = "target.json", ("estimate.csv", "cloud_0.ply")
"""Files in a folder of target results: description of the target, and possible estimates."""
IN_MEMORY = "(in memory)"  #: Path of an input that is not a file.


@dataclass(frozen=True, slots=True)
class ScoreInputs:
    """Input files of a score. A field is None if its file is not given."""

    estimate: Path | None = None  #: Estimated trajectory (TUM, csv or bag).
    truth: Path | None = None  #: True trajectory (TUM, csv, bag or data set folder).
    cloud: Path | None = None  #: Cloud file.
    map_truth: Path | None = None  #: Source with mapping pairs and their truth.
    stats: tuple[Path, ...] = ()  #: CSV files with the calls of localiser and mapper.
    target: Path | None = None  #: CSV file with calls that were measured on a target.
    target_name: str = ""  #: Name of the target.
    target_run: str | None = None  #: Run of the calls on the target, if it is not the run of the estimate.
    target_about: Path | None = None  #: Description of the target (`target.json`).
    #: Configuration of the source of the truth; None: the configuration beside the source.
    config: SourceConfig | None = None
    limits: Path | None = None  #: File of the limits, for provenance.
    configuration: Path | None = None  #: File of `config`, for provenance.
    truth_file: Path | None = None  #: File of the truth that the configuration names, for provenance.
    calibration: Path | None = None  #: Calibration that the configuration names, for provenance.
    columns: str = ""  #: Columns of the estimate, if its file does not name them (`io.tables.column_names`).
    command: str | None = None  #: Command that computes the score, for provenance.

    @classmethod
    def of(cls, estimate: Path, truth: Path, stats: Sequence[Path] | None = None) -> ScoreInputs:
        """Return the inputs of one estimate and its truth: a trajectory, a cloud, or a folder of target results.

        If `stats` is None, the calls are read from the file beside the estimate, if it exists.
        """
        if stats is None:
            beside = stats_beside(estimate)
            stats = [beside] if beside.is_file() else []
        if (about := estimate / TARGET_FILE).is_file():
            poses, cloud = (path if (path := estimate / name).is_file() else None for name in TARGET_RESULTS)
            return cls(
                estimate=poses,
                truth=truth if poses else None,
                cloud=cloud,
                map_truth=truth if cloud else None,
                stats=tuple(stats),
                target=estimate / "stats.csv",
                target_about=about,
            )
        if estimate.suffix.lower() in (*cloud_file.SUFFIXES, *cloud_file.OTHER_SUFFIXES):
            return cls(cloud=estimate, map_truth=truth, stats=tuple(stats))
        return cls(estimate=estimate, truth=truth, stats=tuple(stats))


class FileState(NamedTuple):
    """What changes if a file is replaced or written."""

    device: int
    inode: int
    size: int
    modified_ns: int

    @classmethod
    def of(cls, path: Path) -> FileState:
        """Return the state of the file to which a path leads."""
        found = path.stat()
        return cls(found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns)


def states_of(inputs: ScoreInputs) -> dict[Path, FileState]:
    """Return the states of the existing input files, before they are read."""
    files = (inputs.estimate, inputs.truth, inputs.cloud, inputs.map_truth, inputs.target, inputs.target_about)
    return {path: FileState.of(path) for path in (*files, *inputs.stats) if path is not None and path.exists()}


def check_unchanged(states: Mapping[Path, FileState]) -> None:
    """Raise InputError if a file is no longer the file that was read."""
    for path, state in states.items():
        if not path.exists() or FileState.of(path) != state:
            raise InputError(f"'{path}' was changed or replaced while it was scored: score it again")


@dataclass(frozen=True, slots=True, eq=False)
class DriveToScore:
    """Estimated and true poses of RB in DS."""

    estimates: Estimates  #: Estimated poses.
    truth: Trajectory  #: True poses.
    rig: StereoRig | None = None  #: Rig of the localisation cameras; None if it is unknown.
    image_stamps_ns: IntArray | None = None  #: Stamps of the images; None if they are unknown.
    notes: tuple[str, ...] = ()  #: Detected format of each file, one line each.

    def converted(self, convention: PoseConvention) -> DriveToScore:
        """Return the drive with its estimates converted from a convention to poses of RB in DS."""
        T_rb_child = convention.T_rb_child(self.rig)
        return replace(self, estimates=converted_estimates(self.estimates, convention, T_rb_child, self.truth))


@dataclass(frozen=True, slots=True, eq=False)
class CloudToScore:
    """A cloud and the truth of its pairs."""

    loaded: LoadedCloud
    truths: Sequence[PairTruth]


@dataclass(frozen=True, slots=True)
class Correction:
    """Conversion of an estimate to poses of RB in DS before scoring."""

    declared: PoseConvention = field(default_factory=PoseConvention)  #: Convention that the user declared.
    apply_diagnosis: bool = False  #: Whether a diagnosed mismatch is corrected, too.

    @property
    def is_wanted(self) -> bool:
        """Whether a conversion is requested."""
        return self.apply_diagnosis or bool(self.declared.settings)


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """The available data of a run; absent data is None or empty."""

    inputs: ScoreInputs  #: Input files, for provenance.
    stats: Sequence[CallStats] = ()  #: Calls on this host.
    #: Those of `stats` that the user gave as files, which may belong to another run.
    given_stats: Sequence[CallStats] = ()
    target: CallStats | None = None  #: Calls on the target of `inputs`.
    about: TargetRecord | None = None  #: Description of the target.
    drive: DriveToScore | None = None  #: Trajectory.
    cloud: CloudToScore | None = None  #: Map.
    method: MethodRecord | None = None  #: Method of the run; None: the method in the statistics.
    external: ExternalScore | None = None  #: Figures of an external node; None if there was none.
    findings: tuple[FindingRecord, ...] = ()  #: Findings on the answers of the method.
    #: Conversion of the poses of `drive`; None if they were not converted.
    convention: ConventionRecord | None = None
    unposed_images: int = 0  #: Images of a drive without any estimate.
    nav_stamps_ns: IntArray | None = None  #: Stamps of the mapping pairs of the source; None if they are unknown.
    unmapped_pairs: int = 0  #: Mapping pairs of the source if no cloud can be scored.
    in_memory: Mapping[str, str] = field(default_factory=dict)  #: Hashes of inputs that are not files, by role.
    #: Settings of localiser and mapper that differ from the defaults, for provenance.
    settings: Mapping[str, object] = field(default_factory=dict)
    #: States of the input files before they were read.
    states: Mapping[Path, FileState] = field(default_factory=dict)

    @property
    def all_calls(self) -> list[CallStats]:
        """The calls of the run: first those on this host, then those on a target."""
        return [*self.stats, *([] if self.target is None else [self.target])]
