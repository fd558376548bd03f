"""What a score is made of: the files, what was read from them, and how an estimate is converted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from sfr_loc_map.geometry.arrays import IntArray
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.io.clouds.cloud_file import SUFFIXES as CLOUD_SUFFIXES
from sfr_loc_map.io.clouds.cloud_file import LoadedCloud
from sfr_loc_map.io.source_config import SourceConfig
from sfr_loc_map.metrics.association import Estimates
from sfr_loc_map.metrics.cloud_error import PairTruth
from sfr_loc_map.metrics.convention import converted_estimates
from sfr_loc_map.metrics.pose_convention import PoseConvention
from sfr_loc_map.metrics.records import ConventionRecord, ExternalScore, FindingRecord, MethodRecord, TargetRecord
from sfr_loc_map.runs.calls import CallStats, stats_beside

TARGET_FILE, TARGET_RESULTS = "target.json", ("estimate.csv", "cloud_0.ply")
"""In a folder of results of a target: what it says of itself, and what it may have estimated."""
IN_MEMORY = "(in memory)"  #: Path of an input that is no file.


@dataclass(frozen=True, slots=True)
class ScoreInputs:
    """Files that a score is made of; what is None is omitted."""

    estimate: Path | None = None  #: Estimated trajectory (TUM, csv or bag).
    truth: Path | None = None  #: True trajectory (TUM, csv, bag or data set folder).
    cloud: Path | None = None  #: Cloud file.
    map_truth: Path | None = None  #: Source with mapping pairs and their truth.
    stats: tuple[Path, ...] = ()  #: CSV files with the calls of localiser and mapper.
    target: Path | None = None  #: CSV file with calls that were measured on a target.
    target_name: str = ""  #: Name of the target.
    target_run: str | None = None  #: Which run its calls are of, where it is not that of the estimate.
    target_about: Path | None = None  #: What the target says of itself (`target.json`).
    #: How the source of the truth is read; None: as the configuration beside it says.
    config: SourceConfig | None = None
    limits: Path | None = None  #: File of the limits, for provenance.
    configuration: Path | None = None  #: File of `config`, for provenance.
    truth_file: Path | None = None  #: File of the truth that the configuration names, for provenance.
    calibration: Path | None = None  #: Calibration that the configuration names, for provenance.
    columns: str = ""  #: Columns of the estimate, where its file does not say (`io.pose_columns`).
    command: str | None = None  #: Command that scores them, for provenance.

    @classmethod
    def of(cls, estimate: Path, truth: Path, stats: Sequence[Path] | None = None) -> ScoreInputs:
        """Return the inputs of one estimate and its truth: a trajectory, a cloud, or a folder of a target's results.

        Without named statistics the calls are read from the file beside the estimate, if it exists.
        """
        if stats is None:
            beside = stats_beside(estimate)
            stats = [beside] if beside.is_file() else []
        if (about := estimate / TARGET_FILE).is_file():
            poses, cloud = (path if (path := estimate / name).is_file() else None for name in TARGET_RESULTS)
            calls, truths = estimate / "stats.csv", (truth if poses else None, truth if cloud else None)
            return cls(poses, truths[0], cloud, truths[1], tuple(stats), target=calls, target_about=about)
        if estimate.suffix.lower() in CLOUD_SUFFIXES:
            return cls(cloud=estimate, map_truth=truth, stats=tuple(stats))
        return cls(estimate=estimate, truth=truth, stats=tuple(stats))


@dataclass(frozen=True, slots=True, eq=False)
class DriveToScore:
    """Estimated and true poses of RB in DS."""

    estimates: Estimates  #: Estimated poses.
    truth: Trajectory  #: True poses.
    rig: StereoRig | None = None  #: Rig of the localisation cameras, None where it is unknown.
    image_stamps_ns: IntArray | None = None  #: Stamps of its images; None if they are unknown.
    notes: tuple[str, ...] = ()  #: What the format of each file was found to be, one line each.

    def converted(self, convention: PoseConvention) -> DriveToScore:
        """Return it with estimates that were written in a convention as poses of RB in DS."""
        T_rb_child = convention.T_rb_child(self.rig)
        return replace(self, estimates=converted_estimates(self.estimates, convention, T_rb_child, self.truth))


@dataclass(frozen=True, slots=True, eq=False)
class CloudToScore:
    """A cloud and the truth of its pairs."""

    loaded: LoadedCloud
    truths: Sequence[PairTruth]


@dataclass(frozen=True, slots=True)
class Correction:
    """How an estimate is converted to poses of RB in DS before it is scored."""

    declared: PoseConvention = field(default_factory=PoseConvention)  #: Convention that the user declared.
    apply_diagnosis: bool = False  #: Whether the mismatch that the diagnosis finds then is corrected as well.

    @property
    def is_wanted(self) -> bool:
        """Whether anything is to be converted."""
        return self.apply_diagnosis or bool(self.declared.settings)


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """What there is of a run; what is absent is None or empty."""

    inputs: ScoreInputs  #: Files that it was read from, for provenance.
    stats: Sequence[CallStats] = ()  #: Calls on this host.
    target: CallStats | None = None  #: Calls on the target of `inputs`.
    about: TargetRecord | None = None  #: What the target says of itself.
    drive: DriveToScore | None = None  #: Trajectory.
    cloud: CloudToScore | None = None  #: Map.
    method: MethodRecord | None = None  #: Whose run it is; None: as the statistics say.
    external: ExternalScore | None = None  #: How an external node behaved, None where there was none.
    findings: tuple[FindingRecord, ...] = ()  #: What was wrong with its answers.
    #: How the poses of `drive` have been converted, None where they have not.
    convention: ConventionRecord | None = None
    unposed_images: int = 0  #: Images of a drive for which there is no estimate at all.
    nav_stamps_ns: IntArray | None = None  #: Stamps of the mapping pairs of the source, None where they are unknown.
    unmapped_pairs: int = 0  #: Mapping pairs of the source, where there is no cloud that can be scored.
    in_memory: Mapping[str, str] = field(default_factory=dict)  #: Hash of inputs that are no file, by role.
    #: Settings of localiser and mapper that differ from the defaults, for provenance.
    settings: Mapping[str, object] = field(default_factory=dict)

    @property
    def all_calls(self) -> list[CallStats]:
        """The calls of the run, those on this host before those on a target."""
        return [*self.stats, *([] if self.target is None else [self.target])]
