"""From what there is of a run to its score: trajectory, map, time, memory, verdicts, provenance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

import numpy as np

from sfr_loc_map.geometry.pose_convention import PoseConvention
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.inputs import NS_PER_S
from sfr_loc_map.io.atomic import atomic_path
from sfr_loc_map.io.cloud_file import LoadedCloud
from sfr_loc_map.io.evo_result import evo_result_bytes
from sfr_loc_map.io.hashing import hash_arrays
from sfr_loc_map.io.trajectory_file import trajectory_text
from sfr_loc_map.metrics.aligned_error import absolute_errors, aligned_errors, aligned_poses
from sfr_loc_map.metrics.association import Estimates
from sfr_loc_map.metrics.calls import ScoredCalls, score_calls, score_target, with_external
from sfr_loc_map.metrics.cloud_error import PairTruth, score_map, score_nearest
from sfr_loc_map.metrics.config import AlignedErrorConfig, Condition, ScoreConfig
from sfr_loc_map.metrics.convention import Diagnosis, converted_estimates, diagnose
from sfr_loc_map.metrics.limits import Limits, build_score
from sfr_loc_map.metrics.method_record import FindingRecord, MethodKind, MethodRecord
from sfr_loc_map.metrics.score import ConventionRecord, ExternalScore, MemoryScore, Score, TimingScore
from sfr_loc_map.metrics.trajectory_score import score_trajectory
from sfr_loc_map.pipeline.call_stats import CallStats, load_call_stats
from sfr_loc_map.pipeline.score_inputs import (
    ScoreInputs,
    camera_rig,
    load_drive,
    load_map_truth,
    load_scored_cloud,
    provenance,
)


@dataclass(frozen=True, slots=True, eq=False)
class ScoredDrive:
    """Estimated poses and their truth.

    Attributes:
        estimates: Estimated poses of RB in DS.
        truth: True poses of RB in DS.
        rig: Rig of the localisation cameras, None where it is not known.
    """

    estimates: Estimates
    truth: Trajectory
    rig: StereoRig | None


@dataclass(frozen=True, slots=True)
class Correction:
    """How an estimate is converted to poses of RB in DS before it is scored.

    Attributes:
        declared: What the user says of its convention.
        apply_diagnosis: Whether the mismatch that the diagnosis finds then is corrected as well.
    """

    declared: PoseConvention = field(default_factory=PoseConvention)
    apply_diagnosis: bool = False

    @property
    def is_wanted(self) -> bool:
        """Whether anything is to be converted."""
        return self.apply_diagnosis or bool(self.declared.settings)


def corrected(
    drive: ScoredDrive, correction: Correction, config: ScoreConfig
) -> tuple[ScoredDrive, ConventionRecord | None]:
    """Return a drive as its convention says, and what was done; None where nothing was.

    Args:
        drive: Estimated poses as they were written.
        correction: How they are converted.
        config: Settings.

    Raises:
        ConfigError: If a frame is declared that the rig does not tell.
        MetricsError: If the world frame cannot be aligned.
    """
    done = ConventionRecord(declared=correction.declared.settings)
    if done.declared:
        drive = _converted(drive, correction.declared)
    found = _diagnosis(drive, config).found if correction.apply_diagnosis else None
    if found is not None and found.setting:
        drive = _converted(drive, PoseConvention.parse([found.setting]))
        done = replace(done, diagnosed=found.setting, fitted=found.fitted, sentence=found.sentence)
    return drive, None if done == ConventionRecord() else done


def _converted(drive: ScoredDrive, convention: PoseConvention) -> ScoredDrive:
    T_rb_child = convention.T_rb_child(drive.rig)
    return replace(drive, estimates=converted_estimates(drive.estimates, convention, T_rb_child, drive.truth))


def _diagnosis(drive: ScoredDrive, config: ScoreConfig) -> Diagnosis:
    """Return which single convention mismatch explains how a drive disagrees with its truth."""
    T_rb_left = None if drive.rig is None or drive.rig.T_rb_sb is None else drive.rig.T_rb_left
    return diagnose(drive.estimates.trajectory, drive.truth, config.trajectory.association, T_rb_left)


@dataclass(frozen=True, slots=True, eq=False)
class ScoredCloud:
    """A cloud and its truth.

    Attributes:
        loaded: The cloud.
        truths: Truth of its pairs.
    """

    loaded: LoadedCloud
    truths: Sequence[PairTruth]


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """What there is of a run; what is absent is None or empty.

    Attributes:
        inputs: Files that it was read from, for provenance.
        stats: Calls on this host.
        target: Calls on the target of `inputs`.
        drive: Trajectory.
        cloud: Map.
        method: Whose run it is; None: as the statistics say.
        external: How an external node behaved, None where there was none.
        findings: What was wrong with its answers.
        convention: How the poses of `drive` have been converted, None where they have not.
        in_memory: Hash of inputs that are no file, by role.
        notes: What the format of its files was found to be, one line each.
    """

    inputs: ScoreInputs
    stats: Sequence[CallStats] = ()
    target: CallStats | None = None
    drive: ScoredDrive | None = None
    cloud: ScoredCloud | None = None
    method: MethodRecord | None = None
    external: ExternalScore | None = None
    findings: tuple[FindingRecord, ...] = ()
    convention: ConventionRecord | None = None
    in_memory: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def score_run(
    run: Run, config: ScoreConfig, limits: Limits | None = None, aligned: AlignedErrorConfig | None = None
) -> Score:
    """Return the score of a run.

    Args:
        run: What there is of it.
        config: Settings; conditions that only the limits name are scored as well.
        limits: Limits to judge by.
        aligned: Settings of APE and RPE; None: without them.

    Raises:
        MetricsError: If estimate and truth, or cloud and truth, do not fit.
        InputError: If an input cannot be read for its hash.
    """
    if limits is not None:
        config = _with_conditions(config, limits)
    drive, cloud, convention = run.drive, run.cloud, run.convention
    trajectory, aligned_parts, scored_map, contradiction = None, None, None, None
    warnings: list[str] = []
    data = {}  # a folder and the bag it was converted to have the same truth
    if convention is not None and convention.diagnosed is not None:
        fitted = "; numbers of it were fitted to the truth, which flatters the figures" if convention.fitted else ""
        warnings += [f"--apply-diagnosis converted the estimate by {convention.diagnosed} before scoring it{fitted}"]
    if drive is not None:
        data["truth"] = hash_arrays((drive.truth.stamps_ns, drive.truth.positions))
        if (found := _diagnosis(drive, config).found) is not None:
            remedy = f"--convention {found.setting} or --apply-diagnosis corrects it; " if found.setting else ""
            contradiction = f"{found.sentence} ({remedy}sfr doctor EST TRUTH tells more)"
            warnings += [contradiction]
        trajectory = score_trajectory(drive.estimates, drive.truth, config.trajectory)
        if aligned is not None:
            aligned_parts = aligned_errors(drive.estimates.trajectory, drive.truth, aligned)
    if cloud is not None:
        data["map_truth"] = hash_arrays(truth.points for truth in cloud.truths)
        scored_map = (
            score_nearest(cloud.loaded.xyz, cloud.truths, config.map)
            if cloud.loaded.cloud is None
            else score_map(cloud.loaded.cloud, cloud.truths, config.map)
        )
    calls = [score_calls(item.calls) for item in run.stats]
    if run.external is not None:
        nothing_told = ScoredCalls(TimingScore(), MemoryScore(), None)
        calls = [with_external(item, run.external) for item in calls or [nothing_told]]
    named = [item.method for item in run.stats if item.method is not None]
    others = [method for method in named if method.kind is not MethodKind.BUILT_IN]  # beside ours it is under test
    rest = Score(
        method=run.method or next(iter([*others, *named]), None),
        findings=(*run.findings, *(finding for item in run.stats for finding in item.findings)),
        external=run.external,
        convention=convention,
        aligned=aligned_parts,
        target=None if run.target is None else score_target(run.target.calls, run.inputs.target_name),
        verdicts=(),
        warnings=tuple(warnings),
        contradiction=contradiction,
        provenance=provenance(run.inputs, config, data, run.in_memory),
    )
    return build_score(rest, limits, trajectory=trajectory, map=scored_map, calls=calls)


def score_files(
    inputs: ScoreInputs,
    config: ScoreConfig,
    limits: Limits | None = None,
    *,
    fused: bool | None = None,
    correction: Correction | None = None,
) -> Score:
    """Return the score of files.

    Args:
        inputs: Files.
        config: Settings; conditions that only the limits name are scored as well.
        limits: Limits to judge by.
        fused: Whether the cloud is fused, for files that do not say so.
        correction: How the estimate is converted first, None: not at all.

    Raises:
        SfrError: If a file cannot be read, or nothing can be scored.
    """
    run = load_run(inputs, fused)
    if correction is not None:
        run = converted_run(run, config, correction)
    return score_run(run, config, limits)


def converted_run(run: Run, config: ScoreConfig, correction: Correction | None) -> Run:
    """Return a run whose estimate is converted as its convention says.

    Args:
        run: What there is of it.
        config: Settings.
        correction: How the estimate is converted, None: not at all.

    Raises:
        ConfigError: If a frame is declared that the rig does not tell.
        MetricsError: If the world frame cannot be aligned.
    """
    if run.drive is None or correction is None:
        return run
    drive, convention = corrected(run.drive, correction, config)
    return replace(run, drive=drive, convention=convention)


def load_run(inputs: ScoreInputs, fused: bool | None = None) -> Run:
    """Read files of a run.

    Args:
        inputs: The files.
        fused: Whether the cloud is fused, for files that do not say so.

    Raises:
        SfrError: If a file cannot be read.
    """
    stats = [load_call_stats(path) for path in inputs.stats]
    target = None if inputs.target is None else load_call_stats(inputs.target, needed="processing_time_s")
    drive, cloud, notes = None, None, tuple[str, ...]()
    if inputs.estimate is not None and inputs.truth is not None:
        read = load_drive(inputs.estimate, inputs.truth, stats)
        drive, notes = ScoredDrive(read.estimates, read.truth, camera_rig(inputs.truth)), read.notes
    if inputs.cloud is not None and inputs.map_truth is not None:
        loaded = load_scored_cloud(inputs.cloud, fused)
        stamps_ns = None if loaded.cloud is None else loaded.cloud.pair_stamps_ns
        cloud = ScoredCloud(loaded, load_map_truth(inputs.map_truth, stamps_ns))
    return Run(inputs, stats, target, drive, cloud, notes=notes)


def diagnose_files(estimate: Path, truth: Path, config: ScoreConfig) -> Diagnosis:
    """Return which single convention mismatch explains how the trajectories of two files disagree.

    Raises:
        InputError: If a file cannot be read.
    """
    read = load_drive(estimate, truth)
    return _diagnosis(ScoredDrive(read.estimates, read.truth, camera_rig(truth)), config)


def _with_conditions(config: ScoreConfig, limits: Limits) -> ScoreConfig:
    """Return the settings with the conditions that the limits name added at the end."""
    present = [Condition.parse(text) for text in config.trajectory.conditions]
    missing = tuple(c.setting for c in limits.conditions if c not in present)
    conditions = (*config.trajectory.conditions, *missing)
    return replace(config, trajectory=replace(config.trajectory, conditions=conditions))


def save_evo_result(
    path: Path, estimate: Trajectory, truth: Trajectory, config: AlignedErrorConfig, names: Mapping[str, str]
) -> None:
    """Write the APE of the positions: statistics, single errors, aligned estimate and truth.

    Args:
        path: The zip file.
        estimate: Estimated poses.
        truth: True poses.
        config: Alignment and association.
        names: Names of both, `est_name` and `ref_name`.

    Raises:
        MetricsError: If no stamps are near enough, or the positions allow no alignment.
        OutputError: If the file cannot be written.
    """
    poses = aligned_poses(estimate, truth, config)
    errors = absolute_errors(poses).translation_m
    ape = aligned_errors(estimate, truth, config).ape
    stats = {item.name: getattr(ape.translation, item.name) for item in fields(ape.translation)}
    seconds = poses.stamps_ns / NS_PER_S
    info = {"title": ape.description, "label": "APE (m)", **names}
    arrays = {"error_array": errors, "timestamps": seconds, "seconds_from_start": seconds - seconds[0]}
    texts = {
        f"{names[key]}.tum": trajectory_text(Trajectory(poses.stamps_ns, each.positions, each.quats), tum=True)
        for key, each in (("est_name", poses.estimate), ("ref_name", poses.truth))
    }
    data = evo_result_bytes(info, stats | {"sse": float(np.square(errors).sum())}, arrays, texts)
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)
