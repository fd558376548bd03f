"""The inputs of a score: what the user gives (`ScoreInputs`, `InMemory`, `Correction`), and the run that is scored."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from sfr_loc_map.calls.call_files import stats_beside
from sfr_loc_map.calls.call_stats import CallStats
from sfr_loc_map.geometry.arrays import IntArray
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.hashes import hash_arrays
from sfr_loc_map.io.clouds import cloud_file
from sfr_loc_map.io.clouds.cloud_file import LoadedCloud
from sfr_loc_map.io.source_config import SourceConfig
from sfr_loc_map.metrics.conventions.pose_convention import PoseConvention, converted_estimates
from sfr_loc_map.metrics.figures.records import (
    ConventionRecord,
    ExternalScore,
    FindingRecord,
    MethodRecord,
    TargetRecord,
)
from sfr_loc_map.metrics.frames.association import Estimates
from sfr_loc_map.metrics.map.pair_truth import PairTruth
from sfr_loc_map.scoring.input_files import ReadFile
from sfr_loc_map.suffixes import suffix_of

TARGET_FILE, TARGET_RESULTS = "target.json", ("estimate.csv", "cloud_0.ply")
"""Files in a folder of target results: description of the target, and possible estimates."""
IN_MEMORY = "(in memory)"  #: Path of an input that is not a file.


@dataclass(frozen=True, slots=True)
class ScoreInputs:
    """Files from which a score is computed, and how they are read. A field is None if its file is not given."""

    estimate: Path | None = None  #: Estimated trajectory (TUM, csv or bag).
    truth: Path | None = None  #: True trajectory (TUM, csv, bag or data set folder).
    cloud: Path | None = None  #: Cloud file.
    map_truth: Path | None = None  #: Source with mapping pairs and their truth.
    stats: tuple[Path, ...] = ()  #: CSV files with the calls of localiser and mapper.
    target: Path | None = None  #: CSV file with calls that were measured on a target.
    target_name: str = ""  #: Name of the target.
    target_run: str | None = None  #: Run of the calls on the target, if it is not the run of the estimate.
    target_about: Path | None = None  #: Description of the target (`target.json`).
    limits: Path | None = None  #: File of the limits.
    #: Configuration of the source of the truth; None: the configuration beside the source.
    config: SourceConfig | None = None
    columns: str = ""  #: Columns of the estimate, if its file does not name them (`io.tables.user_columns`).
    #: Whether the source of the truth has the images of the run; false if faults were injected into these images.
    has_images_of_run: bool = True

    @property
    def paths(self) -> tuple[Path, ...]:
        """All given files and folders, and the file of the configuration."""
        given = (self.estimate, self.truth, self.cloud, self.map_truth, self.target, self.target_about, self.limits)
        configured = None if self.config is None else self.config.configuration.path
        return (*self.stats, *(path for path in (*given, configured) if path is not None))

    @classmethod
    def of(cls, estimate: Path, truth: Path | None, stats: Sequence[Path] | None = None) -> ScoreInputs:
        """Return the inputs of one estimate and its truth: a trajectory, a cloud, or a folder of target results.

        `truth` is None if the truth is in memory.

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
        if suffix_of(estimate) in (*cloud_file.SUFFIXES, *cloud_file.OTHER_SUFFIXES):
            return cls(cloud=estimate, map_truth=truth, stats=tuple(stats))
        return cls(estimate=estimate, truth=truth, stats=tuple(stats))


@dataclass(frozen=True, slots=True, eq=False)
class InMemory:
    """Data of a run that are given in memory instead of as files. A field is None if its data are not given."""

    estimate: Trajectory | None = None
    truth: Trajectory | None = None
    cloud: LoadedCloud | None = None
    calls: Sequence[CallStats] = ()

    def hashes(self) -> dict[str, str]:
        """Return the hashes of the estimate, the truth and the cloud by role."""
        trajectories = {"estimate": self.estimate, "truth": self.truth}
        found = {
            role: hash_arrays((poses.stamps_ns, poses.positions, poses.quats_xyzw))
            for role, poses in trajectories.items()
            if poses is not None
        }
        if self.cloud is not None and self.cloud.cloud is not None:
            found["cloud"] = hash_arrays([self.cloud.cloud.to_structured()])
        return found


@dataclass(frozen=True, slots=True, eq=False)
class DriveToScore:
    """Estimated and true poses."""

    estimates: Estimates  #: Estimated poses, as delivered or converted to poses of RB in DS.
    truth: Trajectory  #: True poses of RB in DS.
    rig: StereoRig | None = None  #: Rig of the localisation cameras; None if it is unknown.
    image_stamps_ns: IntArray | None = None  #: Stamps of the images; None if they are unknown.
    notes: tuple[str, ...] = ()  #: Detected format of each file, one line each.
    caveats: tuple[str, ...] = ()  #: Warnings about how the files were read.

    def converted(self, convention: PoseConvention) -> DriveToScore:
        """Return the drive with its estimates converted from a convention to poses of RB in DS."""
        T_rb_child = convention.T_rb_child(self.rig)
        return replace(self, estimates=converted_estimates(self.estimates, convention, T_rb_child, self.truth))


@dataclass(frozen=True, slots=True, eq=False)
class CloudToScore:
    """A cloud and the truth of its pairs."""

    loaded: LoadedCloud
    truths: Sequence[PairTruth]
    caveats: tuple[str, ...] = ()  #: Warnings about the calls of the cloud.


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
class TargetCalls:
    """Calls that were measured on a target."""

    calls: CallStats
    name: str  #: Name of the target.
    about: TargetRecord | None = None  #: Description of the target.
    other_run: str | None = None  #: Run of the calls, if it is not the run of the estimate.


@dataclass(frozen=True, slots=True)
class Origin:
    """Origin of the data of a run, for provenance."""

    files: Mapping[str, ReadFile] = field(default_factory=dict)  #: Input files by role.
    in_memory: Mapping[str, str] = field(default_factory=dict)  #: Hashes of inputs that are not files, by role.
    #: Settings that change the true poses or their stated accuracy (`TruthConfig.changed_content`).
    truth_settings: Mapping[str, object] = field(default_factory=dict)
    #: Settings of localiser and mapper, and of how the source is read, that differ from the defaults.
    settings: Mapping[str, object] = field(default_factory=dict)
    command: str | None = None  #: Command that computes the score.


@dataclass(frozen=True, slots=True)
class ItemUnderTest:
    """The item under test, as far as the calls of the run do not describe it, such as the external node of a replay."""

    method: MethodRecord | None = None  #: Method of the run; None: the method in the calls.
    external: ExternalScore | None = None  #: Figures of an external node; None if there was none.
    findings: tuple[FindingRecord, ...] = ()  #: Findings on the answers of the method.


@dataclass(frozen=True, slots=True, eq=False)
class ExpectedPairs:
    """The pairs for which a run should have results, besides the images of `DriveToScore`."""

    unposed_images: int = 0  #: Number of images of a drive that has no estimate at all; otherwise 0.
    nav_stamps_ns: IntArray | None = None  #: Stamps of the mapping pairs of the source; None if they are unknown.
    unmapped: int = 0  #: Number of mapping pairs without a cloud; used only if there is no cloud to score.

    @property
    def mapping_pairs(self) -> int | None:
        """Number of mapping pairs of the source; None if it is unknown."""
        return None if self.nav_stamps_ns is None else len(np.unique(self.nav_stamps_ns))


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """The available data of a run. Absent data is None or empty.

    The estimated poses are scored as poses of RB in DS. `conversion.converted_run` converts other poses.
    """

    origin: Origin = field(default_factory=Origin)
    stats: Sequence[CallStats] = ()  #: Calls on this host.
    target: TargetCalls | None = None  #: Calls on a target.
    drive: DriveToScore | None = None  #: Trajectory.
    cloud: CloudToScore | None = None  #: Map.
    item: ItemUnderTest = field(default_factory=ItemUnderTest)
    expected: ExpectedPairs = field(default_factory=ExpectedPairs)
    convention: ConventionRecord | None = None  #: Conversion of the poses or of the map; None if nothing was converted.
    caveats: tuple[str, ...] = ()  #: Warnings about given files that may belong to another run.

    @property
    def all_calls(self) -> list[CallStats]:
        """The calls of the run: first those on this host, then those on a target."""
        return [*self.stats, *([] if self.target is None else [self.target.calls])]
