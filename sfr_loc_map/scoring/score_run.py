"""From files, or from what is in memory, to the score: trajectory, map, time, memory, verdicts, provenance."""

from __future__ import annotations

import csv
import logging
import os
import platform
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from msgspec.structs import replace as struct_replace
from numpy.typing import NDArray

from sfr_loc_map import __version__, io  # whose `open_source` is loaded late: files of trajectories need no images
from sfr_loc_map.config import flatten
from sfr_loc_map.errors import ConfigError, InputError, MetricsError, MissingExtraError, SfrError
from sfr_loc_map.geometry.arrays import IntArray
from sfr_loc_map.geometry.pose_convention import PoseConvention
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory, Truth
from sfr_loc_map.inputs import COMMIT, Task, hash_arrays, hash_path, read_text, refusing
from sfr_loc_map.io.atomic import atomic_path
from sfr_loc_map.io.bag_files import is_bag
from sfr_loc_map.io.cloud_file import SUFFIXES as CLOUD_SUFFIXES
from sfr_loc_map.io.cloud_file import LoadedCloud, load_cloud
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.io.source_config import AS_IT_IS, SourceConfig, source_config
from sfr_loc_map.io.trajectory_file import LoadedTrajectory, read_trajectory_file
from sfr_loc_map.io.truth import possible_truth, truth_of_file
from sfr_loc_map.metrics.aligned_error import aligned_errors
from sfr_loc_map.metrics.association import UPPER, Estimates
from sfr_loc_map.metrics.calls import (
    KINDS,
    Calls,
    ScoredCalls,
    completeness_rows,
    concatenated,
    score_calls,
    score_target,
    with_external,
)
from sfr_loc_map.metrics.catalogue import TARGET
from sfr_loc_map.metrics.cloud_error import PairTruth, score_map, score_nearest, truths_of
from sfr_loc_map.metrics.completeness import CALLS, DRIVE, MAP, MEMORY, expected_row, share_rows
from sfr_loc_map.metrics.config import AlignedErrorConfig, AssociationMode, Condition, ScoreConfig, label_of
from sfr_loc_map.metrics.convention import Diagnosis, converted_estimates, diagnose
from sfr_loc_map.metrics.judge import judged, why_incomplete
from sfr_loc_map.metrics.limits import Limits
from sfr_loc_map.metrics.score import (
    Alignment,
    Association,
    CallPlots,
    CallRecords,
    CloudRecord,
    ConventionRecord,
    Details,
    ErrorRows,
    ExternalScore,
    Figure,
    FindingRecord,
    InputFile,
    MapDetails,
    MethodKind,
    MethodRecord,
    Provenance,
    Score,
    TargetRecord,
    TargetRun,
    TrajectoryDetails,
    TruthRecord,
)
from sfr_loc_map.metrics.trajectory_score import score_trajectory
from sfr_loc_map.runs.calls import CallStats, load_call_stats, united
from sfr_loc_map.scoring.contradiction import contradiction_of

_log = logging.getLogger(__name__)
TARGET_FILE, TARGET_RESULTS = "target.json", ("estimate.csv", "cloud_0.ply")
"""In a folder of results of a target: what it says of itself, and what it may have estimated."""
TARGET_SCHEMA = "sfr-target/1"
FEW_TRUE_POSES = 0.5  #: Below so many true poses an image it is said that frames count true poses.
OUTSIDE_SHARE, OUTSIDE_S = 0.5, 0.2  #: Processor time that is of no call from which it is said: share of all, s.
MAX_EXCESS = 0.05  #: Share of the path of a truth that may be noise without a word.
IN_MEMORY = "(in memory)"  #: Path of an input that is no file.


@dataclass(frozen=True, slots=True)
class ScoreInputs:
    """Files that a score is made of; what is None is left out."""

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
    def of(cls, estimate: Path, truth: Path, stats: Sequence[Path] = ()) -> ScoreInputs:
        """Return the inputs of one estimate and its truth: a trajectory, a cloud, or a folder of a target's results."""
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
    rig: StereoRig | None = None  #: Rig of the localisation cameras, None where it is not known.
    image_stamps_ns: IntArray | None = None  #: Stamps of its images, None where they are not known.
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

    declared: PoseConvention = field(default_factory=PoseConvention)  #: What the user says of its convention.
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
    nav_stamps_ns: IntArray | None = None  #: Stamps of the mapping pairs of the source, None where they are not known.
    unmapped_pairs: int = 0  #: Mapping pairs of the source, where there is no cloud that can be scored.
    in_memory: Mapping[str, str] = field(default_factory=dict)  #: Hash of inputs that are no file, by role.


# ---- from a run to its score


def score_files(inputs: ScoreInputs, config: ScoreConfig, limits: Limits | None = None) -> Score:
    """Return the score of files."""
    return score_run(load_run(inputs), config, limits)


def converted_run(run: Run, config: ScoreConfig, correction: Correction) -> Run:
    """Return a run whose estimate is converted as its convention says."""
    if run.drive is None:
        return run
    drive, convention = corrected(run.drive, correction, config)
    return replace(run, drive=drive, convention=convention)


def corrected(
    drive: DriveToScore, correction: Correction, config: ScoreConfig
) -> tuple[DriveToScore, ConventionRecord | None]:
    """Return a drive as its convention says, and what was done; None where nothing was."""
    done = ConventionRecord(declared=correction.declared.settings)
    if done.declared:
        drive = drive.converted(correction.declared)
    found = None
    if correction.apply_diagnosis:
        found = diagnose(drive.estimates.trajectory, drive.truth, config.trajectory.association, drive.rig).found
    if found is not None and found.setting:
        drive = drive.converted(PoseConvention.parse([found.setting]))
        done = struct_replace(done, diagnosed=found.setting, fitted=found.fitted, sentence=found.sentence)
    return drive, None if done == ConventionRecord() else done


@dataclass(frozen=True, slots=True, kw_only=True)
class _Part:
    """What one part of a run adds to its score."""

    figures: tuple[Figure, ...] = ()
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class _DrivePart(_Part):
    association: Association | None = None
    truth: TruthRecord | None = None
    alignment: Alignment | None = None
    contradiction: str | None = None
    errors: tuple[ErrorRows, ...] = ()
    details: TrajectoryDetails | None = None
    data_sha256: str | None = None  #: Of the values of the truth: a folder and a bag made of it have the same.


@dataclass(frozen=True, slots=True, kw_only=True)
class _MapPart(_Part):
    cloud: CloudRecord | None = None
    details: MapDetails | None = None
    data_sha256: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class _CallsPart(_Part):
    records: CallRecords | None = None
    plots: Mapping[str, CallPlots] = field(default_factory=dict)
    target: TargetRun | None = None


def score_run(
    run: Run, config: ScoreConfig, limits: Limits | None = None, aligned: AlignedErrorConfig | None = None
) -> Score:
    """Return the score of a run, also for conditions that only the limits name; with settings, APE and RPE as well."""
    config = _with_conditions(config, limits)
    drive = _drive_part(run, config, aligned, () if limits is None else limits.bounded)
    cloud = _map_part(run, config)
    calls = _calls_part(run)
    method = _method_of(run)
    warnings = [*_convention_warnings(run.convention), *drive.warnings]
    warnings += calls.warnings
    warnings += () if method is None else _process_warnings(method, run.stats)
    score = Score(
        figures=(*drive.figures, *cloud.figures, *calls.figures),
        association=drive.association,
        truth=drive.truth,
        provenance=_provenance(run, config, drive.data_sha256, cloud.data_sha256),
        alignment=drive.alignment,
        cloud=cloud.cloud,
        calls=calls.records,
        target=calls.target,
        method=method,
        findings=(*run.findings, *(finding for item in run.stats for finding in item.findings)),
        processes=next((item.processes for item in run.stats if item.processes is not None), None),
        external=run.external,
        convention=run.convention,
        warnings=tuple(warnings),
        contradiction=drive.contradiction,
        errors=drive.errors,
        details=_details(drive.details, cloud.details, calls.plots),
    )
    score = judged(score, limits, partial=config.trajectory.partial)
    return struct_replace(score, warnings=(*score.warnings, *_partial_warnings(score), *_reading_warnings(score)))


def _partial_warnings(score: Score) -> Iterator[str]:
    """Yield what is missing of the whole that nothing but the user's consent lets pass."""
    if score.incomplete is None and (text := why_incomplete(struct_replace(score, rules=None))) is not None:
        yield f"a part of the drive is judged: {text}"


def _with_conditions(config: ScoreConfig, limits: Limits | None) -> ScoreConfig:
    """Return settings with the conditions that only the limits name."""
    present = [Condition.parse(text) for text in config.trajectory.conditions]
    missing = [] if limits is None else [item.setting for item in limits.conditions if item not in present]
    conditions = (*config.trajectory.conditions, *missing)
    return replace(config, trajectory=replace(config.trajectory, conditions=conditions))


def _details(
    trajectory: TrajectoryDetails | None, cloud: MapDetails | None, calls: Mapping[str, CallPlots]
) -> Details | None:
    found = Details(trajectory=trajectory, map=cloud, calls=dict(calls))
    return None if found == Details() else found


# ---- the trajectory


def _drive_part(
    run: Run, config: ScoreConfig, aligned: AlignedErrorConfig | None, bounded: Collection[tuple[str, str]]
) -> _DrivePart:
    drive = run.drive
    if drive is None and run.unposed_images:
        many = run.unposed_images
        return _DrivePart(figures=(expected_row(DRIVE, 0, many), *share_rows("missing", many, many)))
    if drive is None:
        return _DrivePart()
    association = config.trajectory.association
    contradiction = contradiction_of(drive.estimates.trajectory, drive.truth, association, drive.rig)
    scored = score_trajectory(
        drive.estimates, drive.truth, config.trajectory, image_stamps_ns=drive.image_stamps_ns, bounded=bounded
    )
    figures, alignment = scored.figures, None
    if aligned is not None:
        beside = aligned_errors(drive.estimates.trajectory, drive.truth, aligned)
        figures, alignment = (*figures, *beside.figures), beside.alignment
    warnings = [] if contradiction is None else [contradiction]
    warnings += _frame_warnings(drive, scored.association)
    warnings += truth_warnings(scored.truth)
    return _DrivePart(
        figures=figures,
        warnings=tuple(warnings),
        association=scored.association,
        truth=scored.truth,
        alignment=alignment,
        contradiction=contradiction,
        errors=scored.errors,
        details=scored.details,
        data_sha256=hash_arrays((drive.truth.stamps_ns, drive.truth.positions)),
    )


def _frame_warnings(drive: DriveToScore, association: Association) -> Iterator[str]:
    """Yield that frames are those of a sparse truth."""
    many, what = association.images, "images"
    if not many:
        many, what = len(drive.estimates.trajectory), "estimates"
    if association.mode is AssociationMode.MATCH and association.truth_poses < FEW_TRUE_POSES * many:
        yield (
            f"the truth has {association.truth_poses} poses for {many} {what}: frames and spacing count true poses; "
            "sfr score --frames images interpolates the truth to every image"
        )


def _convention_warnings(convention: ConventionRecord | None) -> Iterator[str]:
    if convention is not None and convention.diagnosed is not None:
        fitted = "; numbers of it were fitted to the truth, which flatters the figures" if convention.fitted else ""
        yield f"--apply-diagnosis converted the estimate by {convention.diagnosed} before scoring it{fitted}"


def _reading_warnings(score: Score) -> Iterator[str]:
    """Yield that the reading of the document decides verdicts."""
    differ = [item for item in score.verdicts if len(set(item.by_reading.values())) > 1]
    if not differ or score.contradiction is not None:
        return
    first = differ[0]
    each = ", ".join(f"{reading} {state}" for reading, state in first.by_reading.items())
    over = f" over {label_of(first.condition)}" if first.condition else ""
    text = f"the reading of the document (--rebase) decides {len(differ)} of {len(score.verdicts)} verdicts, the first"
    yield f"{text} {first.name}{over}: {each}"


def truth_warnings(about: TruthRecord) -> Iterator[str]:
    """Yield what a score by this truth does not hold."""
    if not about.attitude:
        tilt = "" if about.tilt_deg is None else f", its z by {about.tilt_deg:.3g} deg,"
        yield (
            "the truth has positions alone: attitude and heading errors are not known; the estimate was turned by "
            f"{about.yaw_deg or 0.0:.3g} deg about z{tilt} and moved to fit it over the drive, so that attitude errors "
            "from before a sub-trajectory count in its position error (chord errors need no fit)"
        )
    if about.path_excess is not None and about.path_excess > MAX_EXCESS:
        yield (
            f"the noise of the truth ({about.sigma_m:.3g} m) lengthens its path by about "
            f"{100.0 * about.path_excess:.3g} %: a sub-trajectory distance=METRES ends too early; give "
            "displacement=METRES, or a smoothed truth"
        )


# ---- the map


def _map_part(run: Run, config: ScoreConfig) -> _MapPart:
    if run.cloud is None and run.unmapped_pairs:
        many = run.unmapped_pairs
        return _MapPart(figures=(expected_row(MAP, 0, many), *share_rows("pairs_without_cloud", many, many)))
    if run.cloud is None:
        return _MapPart()
    loaded, truths = run.cloud.loaded, run.cloud.truths
    pairs = None if run.nav_stamps_ns is None else len(np.unique(run.nav_stamps_ns))
    if loaded.cloud is None:
        scored = score_nearest(loaded.xyz, truths, config.map, expected_pairs=pairs, not_finite=loaded.not_finite)
    else:
        scored = score_map(loaded.cloud, truths, config.map, expected_pairs=pairs, not_finite=loaded.not_finite)
    return _MapPart(
        figures=scored.figures,
        cloud=scored.cloud,
        details=scored.details,
        data_sha256=hash_arrays(truth.points for truth in truths),
    )


# ---- the calls


def _calls_part(run: Run) -> _CallsPart:
    of_host = score_calls(concatenated([item.calls for item in run.stats])) if run.stats else ScoredCalls()
    if run.external is not None:
        of_host = with_external(of_host, run.external)
    records = of_host.records if run.stats or run.external is not None else None
    expected = _expected_calls(run)
    stamped = [concatenated([_stamped(item, expected) for item in run.stats])] if run.stats else []
    figures = [*of_host.figures, *completeness_rows(stamped, expected)]
    if (node := run.external) is not None:
        figures = [row for row in figures if row.part not in (f"{CALLS} {node.task}", f"{MEMORY} {node.task}")]
        answers = node.answers
        figures.append(expected_row(f"{CALLS} {node.task}", answers.answered, answers.pairs))
        if node.process is not None:
            figures.append(expected_row(f"{MEMORY} {node.task}", 1, 1))  # of its processes over the whole run
    if run.target is None:
        return _CallsPart(figures=tuple(figures), records=records, plots=of_host.plots)
    of_target, target = _scored_target(run, run.target)
    figures += [*of_target, *completeness_rows([_stamped(run.target, expected)], expected, f"{TARGET} ")]
    warnings = tuple(_target_warnings(target))
    return _CallsPart(figures=tuple(figures), records=records, plots=of_host.plots, target=target, warnings=warnings)


def _expected_calls(run: Run) -> dict[Task, IntArray | None]:
    """Return the stamps of the pairs that each task has a call for: those of the source, else of the truth."""
    images = None if run.drive is None else run.drive.image_stamps_ns
    if images is None and run.drive is not None:
        images = run.drive.truth.stamps_ns
    return {Task.LOCALISATION: images, Task.MAPPING: run.nav_stamps_ns}


def _stamped(stats: CallStats, expected: Mapping[Task, IntArray | None]) -> Calls:
    """Return calls with stamps; calls that are only numbered are those of the expected pairs in their order."""
    if stats.has_stamps:
        return stats.calls
    stamps = -1 - stats.calls.stamps_ns
    for task in Task:
        is_localisation = task is Task.LOCALISATION
        mine = np.flatnonzero([(state not in KINDS) == is_localisation for state in stats.calls.states])
        known = expected.get(task)
        of_drive = mine[: 0 if known is None else len(np.unique(known))]
        if known is not None:
            stamps[of_drive] = np.unique(known)[: len(of_drive)]
    return replace(stats.calls, stamps_ns=stamps)


def _scored_target(run: Run, calls: CallStats) -> tuple[tuple[Figure, ...], TargetRun]:
    name = run.inputs.target_name or "target"
    if run.about is not None:
        name = run.about.board or "a board that is not named"
    stamps = None if run.drive is None else run.drive.estimates.trajectory.stamps_ns
    other_run = run.inputs.target_run
    figures, target = score_target(calls.calls, name, stamps, has_stamps=calls.has_stamps, other_run=other_run)
    return figures, struct_replace(target, about=run.about)


def _target_warnings(target: TargetRun) -> Iterator[str]:
    if target.other_run is not None:
        yield f"the times of {target.name} are of another run: {target.other_run}"
    elif target.matched_share is not None and target.matched_share < 1.0:
        yield f"the times of {target.name} are of {100.0 * target.matched_share:.3g} % of the estimates"


def _method_of(run: Run) -> MethodRecord | None:
    """Return whose run it is; a method under test rather than the one of this suite beside it."""
    methods = [item.method for item in run.stats if item.method is not None]
    others = [method for method in methods if method.kind is not MethodKind.BUILT_IN]
    return run.method or next(iter([*others, *methods]), None)


def _process_warnings(method: MethodRecord, stats: Sequence[CallStats]) -> Iterator[str]:
    if "not " in (method.isolation or ""):
        yield f"method {method.name} was not isolated, it may have read any file: {method.isolation}"
    for usage in (item.processes for item in stats if item.processes is not None):
        outside_s = usage.cpu_outside_s or 0.0
        if outside_s > max(OUTSIDE_SHARE * usage.cpu_s, OUTSIDE_S):
            told = f"{outside_s:.3g} s of its {usage.cpu_s:.3g} s of processor time"
            yield f"the method works outside its calls: {told}; no time of a call has them"


# ---- provenance


def _provenance(run: Run, config: ScoreConfig, truth_sha256: str | None, map_truth_sha256: str | None) -> Provenance:
    inputs = run.inputs
    data = {"truth": truth_sha256, "map_truth": map_truth_sha256}
    paths: dict[str, Path | None] = {
        "estimate": inputs.estimate,
        "truth": inputs.truth,
        "cloud": inputs.cloud,
        "map_truth": inputs.map_truth,
        "target": inputs.target,
        "target_about": inputs.target_about,
        "limits": inputs.limits,
        "configuration": inputs.configuration,
        "truth_file": inputs.truth_file,
        "calibration": inputs.calibration,
    }
    paths |= {f"stats_{number}": path for number, path in enumerate(inputs.stats)}
    files: dict[str, InputFile] = {}
    for name, path in paths.items():
        if path is not None:
            hashed = _trajectory_in(path) if name == "truth" else path
            files[name] = InputFile(path=str(hashed), sha256=hash_path(hashed), data_sha256=data.get(name))
    if run.drive is not None and isinstance(run.drive.truth, Truth) and "truth" in files:
        files["truth"] = struct_replace(files["truth"], read_from=run.drive.truth.read_from or None)
    for name, sha256 in run.in_memory.items():
        files[name] = InputFile(path=IN_MEMORY, sha256=sha256, data_sha256=data.get(name))
    return Provenance(
        version=__version__,
        commit=COMMIT,
        command=inputs.command,
        inputs=files,
        configuration=flatten(config),
        host=host_facts(),
        time=datetime.now(UTC).isoformat(timespec="seconds"),
    )


def host_facts() -> dict[str, str]:
    """Return what is known of this host: machine, system, Python; processor, kernel, load and governor."""
    found = {"machine": platform.machine(), "system": platform.system(), "python": platform.python_version()}
    found["kernel"] = platform.release()
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
        names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
        found["processor"] = names[0] if names else "unknown"
    with suppress(OSError):
        found["load"] = f"{os.getloadavg()[0]:.2f} of {os.cpu_count()} processors"
    with suppress(OSError):
        governor = Path("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor")
        found["governor"] = governor.read_text(encoding="utf-8").strip()
    return found


def _existing(name: str) -> Path | None:
    """Return the file of a name in a configuration; None where it is empty or the name of a topic."""
    return Path(name) if name and Path(name).exists() else None


def _trajectory_in(path: Path) -> Path:
    """Return the file of true poses of a data set folder: of the folder nothing else counts; otherwise the path."""
    if not path.is_dir() or is_bag(path):
        return path
    places = [path / "groundtruth.csv", path / "loc" / "groundtruth.csv"]
    return next((place for place in places if place.is_file()), path)


# ---- from files to a run


def load_run(
    inputs: ScoreInputs,
    fused: bool | None = None,
    *,
    estimate: Trajectory | None = None,
    truth: Trajectory | None = None,
    calls: Sequence[CallStats] = (),
) -> Run:
    """Read files of a run; poses without stamps get those of the other ones, pose by pose.

    Lost flags and covariances of an estimate come from its bag or from the statistics of the calls that gave it. Poses
    and calls may be in memory; `fused` is for cloud files that do not say so.
    """
    stats = [*(load_call_stats(path) for path in inputs.stats), *calls]
    target = None if inputs.target is None else load_call_stats(inputs.target, needed="processing_time_s")
    run = _with_cloud(_with_target(Run(inputs, stats, target)), fused)
    how = _how_to_read(inputs)
    truth_file, calibration = _existing(how.truth.source), _existing(how.calibration.file)
    named = replace(inputs, configuration=how.path, truth_file=truth_file, calibration=calibration)
    run = replace(run, inputs=named)
    if inputs.truth is None and truth is None:
        return run
    true, opened = _read_truth(inputs.truth, truth, how)
    read = _read_estimate(inputs, estimate, true, run)
    if read is None:
        return run
    found, estimates = read
    if true.by_index:
        true = true.with_stamps_of(found)
    true = _as_declared(true, inputs.truth, how)
    refuse_copy(inputs, estimates.trajectory, true.trajectory)
    notes = tuple(item.text for item in (found, true) if item.is_announced)
    run = _with_nav_stamps(run, opened)
    rig, images = _images_of(opened)
    return replace(run, drive=DriveToScore(estimates, true.trajectory, rig, images, notes))


def refuse_copy(inputs: ScoreInputs, estimate: Trajectory, truth: Trajectory) -> None:
    """Raise MetricsError where limits would judge true poses: each is equal bit by bit, as no measurement is."""
    rows = np.searchsorted(truth.stamps_ns, estimate.stamps_ns)
    if inputs.limits is None or len(estimate) < 2 or not len(truth) or rows.max() >= len(truth):
        return
    names = ("stamps_ns", "positions", "quats_xyzw")
    if all(np.array_equal(getattr(estimate, name), getattr(truth, name)[rows]) for name in names):
        raise MetricsError(
            f"the estimate '{inputs.estimate}' is equal to the ground truth bit by bit. Limits judge an estimate of "
            "the item under test: give its estimate"
        )


def _with_target(run: Run) -> Run:
    """Return a run with what the target says of itself."""
    if run.inputs.target_about is None:
        return run
    about = load_target(run.inputs.target_about)
    method = MethodRecord(name="candidate", version=about.candidate, kind=MethodKind.LIBRARY)
    return replace(run, about=about, method=method)


def _with_cloud(run: Run, fused: bool | None) -> Run:
    """Return a run with its cloud and the truth of the pairs that the cloud was made of."""
    inputs = run.inputs
    if inputs.cloud is None or inputs.map_truth is None:
        return run
    loaded = said_fused(load_cloud(inputs.cloud), fused, f"cloud '{inputs.cloud}'")
    stamps_ns = None if loaded.cloud is None else loaded.cloud.pair_stamps_ns
    truths, nav_stamps_ns = load_map_truth(inputs.map_truth, stamps_ns, inputs.config)
    if truths:
        loaded = loaded.of_images(truths[0].rig.width, truths[0].rig.height, f"cloud '{inputs.cloud}'")
    return replace(run, cloud=CloudToScore(loaded, truths), nav_stamps_ns=nav_stamps_ns)


def _how_to_read(inputs: ScoreInputs) -> SourceConfig:
    """Return how the source of the truth is read: as given, else as the configuration beside it says."""
    place = inputs.truth or inputs.map_truth
    if place is not None and inputs.config is None and (place.is_dir() or is_bag(place)):
        return source_config(place)
    return inputs.config or AS_IT_IS


def _read_truth(
    place: Path | None, truth: Trajectory | None, how: SourceConfig
) -> tuple[LoadedTrajectory, Source | None]:
    """Read true poses of a file, bag or data set folder, else those in memory; and the source of their images."""
    if place is None:
        assert truth is not None  # one of both is there
        return LoadedTrajectory(Path(IN_MEMORY), truth), None
    if is_bag(place) or how.truth.source:
        true, opened = LoadedTrajectory(place, truth_of_file(place, how.truth, how.remap)), None
        if is_bag(place) or not place.is_file():
            with suppress(SfrError):  # true poses alone: whoever needs the images reports what is wrong with them
                opened = io.open_source(place, how)
        return true, opened
    if place.is_file():
        return read_trajectory_file(place, how.truth.columns, "truth"), None
    source = io.open_source(place, how)
    if source.loc is None or source.loc.ground_truth is None:
        text = f"'{place}' has no true poses (groundtruth.csv, ground_truth/odometry): give a source with truth"
        raise InputError(text)
    return LoadedTrajectory(place, source.loc.ground_truth), source


def _read_estimate(
    inputs: ScoreInputs, estimate: Trajectory | None, true: LoadedTrajectory, run: Run
) -> tuple[LoadedTrajectory, Estimates] | None:
    """Read the estimated poses of a bag or file, else those in memory; None if there are none."""
    if inputs.estimate is not None and is_bag(inputs.estimate):
        estimates = load_estimates(inputs.estimate)
        return LoadedTrajectory(inputs.estimate, estimates.trajectory), estimates
    if inputs.estimate is not None:
        found = read_trajectory_file(inputs.estimate, inputs.columns, "estimate")
    elif estimate is not None:
        found = LoadedTrajectory(Path(IN_MEMORY), estimate)
    else:
        return None
    if found.by_index:
        found = found.with_stamps_of(true)
    estimates = estimates_of(found.trajectory, run.stats, run.target)
    if found.covariance is not None and estimates.covariance is None:
        estimates = replace(estimates, covariance=found.covariance[:, *UPPER])
    return found, estimates


def _as_declared(true: LoadedTrajectory, place: Path | None, how: SourceConfig) -> LoadedTrajectory:
    """Return true poses as the configuration declares them; without a declaration those of a file that can be true."""
    if how.truth != AS_IT_IS.truth:
        return replace(true, trajectory=how.truth.applied(true.trajectory, read_from=true.text))
    if place is not None and place.is_file() and not is_bag(place):
        return replace(true, trajectory=possible_truth(true.trajectory, f"of '{place}'")[1])
    return true


def _images_of(source: Source | None) -> tuple[StereoRig | None, IntArray | None]:
    """Return the rig of a source's localisation pairs and their stamps, None for what is unknown."""
    if source is None or source.loc is None:
        return None, None
    with suppress(InputError):  # it has no complete pair
        return source.loc.rig, np.asarray(source.loc.stamps_ns, np.int64)
    return source.loc.rig, None


def _with_nav_stamps(run: Run, source: Source | None) -> Run:
    """Return a run with the stamps of the mapping pairs of its source if calls of a mapper are compared with them."""
    stats = [*run.stats, *([] if run.target is None else [run.target])]
    if source is None or source.nav is None or run.nav_stamps_ns is not None:
        return run
    if not any(state in KINDS for item in stats for state in item.calls.states):
        return run
    stamps = np.array([item.pair.stamp_ns for item in source.nav.pairs()], np.int64)
    return replace(run, nav_stamps_ns=stamps)


def load_target(path: Path) -> TargetRecord:
    """Read what a target says of itself; InputError if it is not as the harness writes it."""
    with refusing(f"target '{path}' cannot be read", "give what the harness wrote"):
        content = msgspec.json.decode(read_text(path), type=dict[str, Any])
        if content.pop("schema", None) != TARGET_SCHEMA:
            raise ValueError(f"no schema {TARGET_SCHEMA}")
        return msgspec.convert(content, TargetRecord)


def load_drive(estimate: Path, truth: Path) -> DriveToScore:
    """Read estimated and true poses of files."""
    drive = load_run(ScoreInputs(estimate=estimate, truth=truth)).drive
    assert drive is not None  # both are there
    return drive


def load_estimates(path: Path, stats: Sequence[CallStats] = ()) -> Estimates:
    """Read estimated poses; lost flags and covariances come from the bag or from the statistics of the calls."""
    if not is_bag(path):
        return estimates_of(read_trajectory_file(path).trajectory, stats)
    from sfr_loc_map.scoring.bag_estimates import bag_estimates

    return bag_estimates(path)


def estimates_of(trajectory: Trajectory, stats: Sequence[CallStats] = (), target: CallStats | None = None) -> Estimates:
    """Return estimated poses with the lost flags and covariances of the calls that gave them.

    The calls are those of all files of this host together or, if these have no call of a pose, those of the target.
    """
    of_target = [] if target is None or not target.has_stamps else [target]
    stamps = set(trajectory.stamps_ns.tolist())
    for items in (stats, of_target):
        if own := [item for item in items if not stamps.isdisjoint(item.localised)]:
            return united(own).estimates(trajectory)
    if any(item.localised for item in (*stats, *of_target)):
        _log.warning("no call of the statistics has the stamp of an estimate: which poses are lost is not known")
    return Estimates.of(trajectory)


def load_map_truth(
    path: Path, stamps_ns: Sequence[int] | None = None, config: SourceConfig | None = None
) -> tuple[list[PairTruth], IntArray]:
    """Read the truth of the mapping pairs of a source, all or those of some stamps in their order; and all stamps."""
    nav = io.open_source(path, config).nav
    if nav is None:
        raise InputError(f"'{path}' has no mapping pairs: a cloud is scored against a source with nav pairs and truth")
    wanted = None if stamps_ns is None else set(stamps_ns)
    pairs: dict[int, PosedStereoPair] = {}
    every: list[int] = []
    for item in nav.pairs():
        every.append(item.pair.stamp_ns)
        if wanted is None or item.pair.stamp_ns in wanted:
            pairs[item.pair.stamp_ns] = item
    missing = [str(stamp_ns) for stamp_ns in stamps_ns or () if stamp_ns not in pairs]
    if missing:
        raise InputError(
            f"the cloud was made of pairs of stamps {', '.join(missing)}, which '{path}' does not have: give the "
            "source that it was made from"
        )
    chosen = pairs.values() if stamps_ns is None else [pairs[stamp_ns] for stamp_ns in stamps_ns]
    return truths_of(list(chosen), nav.rig), np.array(every, np.int64)


def said_fused(loaded: LoadedCloud, fused: bool | None, name: str) -> LoadedCloud:
    """Return a cloud that says whether it is fused, unless its points have no pixels."""
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


# ---- beside the score


def diagnose_run(inputs: ScoreInputs, config: ScoreConfig) -> Diagnosis:
    """Return which single convention mismatch explains how the trajectories of files disagree."""
    drive = load_run(inputs).drive
    if drive is None:
        raise MetricsError(f"'{inputs.truth}' and the estimate are no trajectories: a diagnosis is of poses")
    if not drive.truth.has_attitude:
        text = "has positions alone: no convention mismatch can be told from them"
        raise MetricsError(f"the truth '{inputs.truth}' {text}")
    return diagnose(drive.estimates.trajectory, drive.truth, config.trajectory.association, drive.rig)


def save_table(path: Path, columns: Mapping[str, NDArray[Any]]) -> None:
    """Write columns of one length as a table, parquet or csv; numbers of a csv read back to the same bits."""
    with atomic_path(path) as temporary:
        if path.suffix == ".csv":
            with temporary.open("w", encoding="utf-8", newline="") as stream:
                writer = csv.writer(stream, lineterminator="\n")
                writer.writerow(columns)
                writer.writerows(zip(*(values.tolist() for values in columns.values()), strict=True))
            return
        try:
            import pyarrow
            import pyarrow.parquet
        except ImportError as error:
            raise MissingExtraError(
                f"'{path}' needs pyarrow: pip install 'sfr_loc_map[suite]', or name a .csv"
            ) from error
        pyarrow.parquet.write_table(pyarrow.table(dict(columns)), temporary)
