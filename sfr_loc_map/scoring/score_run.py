"""From a run that is over to its score: trajectory, map, time, memory, verdicts."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from msgspec.structs import replace as struct_replace

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.inputs import hash_arrays
from sfr_loc_map.metrics.catalogue import ERRORS_BEYOND
from sfr_loc_map.metrics.caveats import reading_caveats
from sfr_loc_map.metrics.config import AlignedErrorConfig, Condition, ScoreConfig
from sfr_loc_map.metrics.convention import Diagnosis, diagnose
from sfr_loc_map.metrics.details import CallPlots, Details, MapDetails, TrajectoryDetails
from sfr_loc_map.metrics.judging.incomplete import why_not_whole
from sfr_loc_map.metrics.judging.judge import judged
from sfr_loc_map.metrics.limits import Limits
from sfr_loc_map.metrics.pose_convention import PoseConvention
from sfr_loc_map.metrics.records import ConventionRecord, MethodKind, MethodRecord, Provenance
from sfr_loc_map.metrics.score import Score
from sfr_loc_map.runs.calls import CallStats
from sfr_loc_map.scoring.inputs import Correction, DriveToScore, Run, ScoreInputs
from sfr_loc_map.scoring.load import load_run
from sfr_loc_map.scoring.provenance import provenance_of
from sfr_loc_map.scoring.score_parts import (
    CallsResult,
    DriveResult,
    MapResult,
    calls_result,
    drive_result,
    expected_calls,
    map_result,
    result_without_cloud,
    result_without_poses,
    with_aligned_errors,
)

OUTSIDE_SHARE, OUTSIDE_S = 0.5, 0.2  #: Processor time that is of no call from which it is said: share of all, s.


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
        done = struct_replace(done, fitted=correction.declared.has_fitted_unit)
    found = None
    if correction.apply_diagnosis:
        found = diagnose(drive.estimates.trajectory, drive.truth, config.trajectory.association, drive.rig).found
    if found is not None and found.setting:
        drive = drive.converted(PoseConvention.parse([found.setting]))
        done = struct_replace(done, diagnosed=found.setting, fitted=found.fitted, sentence=found.sentence)
    return drive, None if done == ConventionRecord() else done


def score_run(
    run: Run,
    config: ScoreConfig,
    limits: Limits | None = None,
    aligned: AlignedErrorConfig | None = None,
    kept_errors: Collection[tuple[str, str]] = (),
) -> Score:
    """Return the score of a run, also for conditions that only the limits name; with settings, APE and RPE as well.

    All errors are kept of the figures of the trajectory that are limited, and of `kept_errors`.
    """
    config = with_conditions(config, limits)
    trajectory = result_without_poses(run.unposed_images)
    truth_sha256 = map_truth_sha256 = None
    if run.drive is not None:
        mismatch = convention_mismatch(run.drive, config) or fitted_unit(run.convention)
        trajectory = drive_result(run.drive, config.trajectory, mismatch, all_kept(limits, kept_errors))
        truth_sha256 = hash_arrays((run.drive.truth.stamps_ns, run.drive.truth.positions))
    if run.drive is not None and aligned is not None:
        trajectory = with_aligned_errors(trajectory, run.drive, aligned)
    surface = result_without_cloud(run.unmapped_pairs)
    if run.cloud is not None:
        pairs = None if run.nav_stamps_ns is None else len(np.unique(run.nav_stamps_ns))
        surface = map_result(run.cloud, config.map, pairs)
        map_truth_sha256 = hash_arrays(truth.points for truth in run.cloud.truths)
    calls = calls_result(run, expected_calls(run))
    provenance = provenance_of(run, config, truth_sha256, map_truth_sha256)
    score = judged_with_warnings(assembled(run, trajectory, surface, calls, provenance), config, limits)
    if any(item.figure == ERRORS_BEYOND for item in score.verdicts):
        score = struct_replace(score, warnings=(*score.warnings, *trajectory.unjudged))
    return score


# ---- what a run that is over and a run in progress have in common


def with_conditions(config: ScoreConfig, limits: Limits | None) -> ScoreConfig:
    """Return settings with the conditions that only the limits name."""
    present = [Condition.parse(text).setting for text in config.trajectory.conditions]
    missing = [] if limits is None else [item for item in limits.conditions if item not in present]
    conditions = (*config.trajectory.conditions, *missing)
    return replace(config, trajectory=replace(config.trajectory, conditions=conditions))


def all_kept(limits: Limits | None, further: Collection[tuple[str, str]] = ()) -> frozenset[tuple[str, str]]:
    """Return the figures and conditions of the trajectory whose errors are all kept."""
    limited = frozenset() if limits is None else limits.figures_with_all_errors
    return limited.union(further)


def fitted_unit(convention: ConventionRecord | None) -> str | None:
    """Return why an estimate with a declared unit is not judged; None if it is a unit of length."""
    if convention is None or not PoseConvention.parse(convention.declared).has_fitted_unit:
        return None
    return (
        f"the declared factor of the positions ({', '.join(convention.declared)}) is no unit of length: a factor that "
        "was fitted to the ground truth hides a scale error; give a power of ten of a metre, inch, foot or yard"
    )


def convention_mismatch(drive: DriveToScore, config: ScoreConfig) -> str | None:
    """Return the convention mismatch that explains how estimate and truth disagree, and its remedy; None without."""
    association = config.trajectory.association
    found = diagnose(drive.estimates.trajectory, drive.truth, association, drive.rig, every=False).found
    if found is None:
        return None
    remedy = f"--convention {found.setting} or --apply-diagnosis corrects it; " if found.setting else ""
    return f"{found.sentence} ({remedy}sfr score EST TRUTH --diagnose shows every hypothesis)"


def assembled(
    run: Run, trajectory: DriveResult, surface: MapResult, calls: CallsResult, provenance: Provenance | None
) -> Score:
    """Return the score that the parts of a run make, without verdicts."""
    method = _method_of(run)
    warnings = [*_convention_warnings(run.convention), *trajectory.warnings, *surface.warnings, *calls.warnings]
    warnings += () if method is None else _process_warnings(method, run.stats)
    return Score(
        figures=(*trajectory.figures, *surface.figures, *calls.figures),
        association=trajectory.association,
        truth=trajectory.truth,
        provenance=provenance,
        alignment=trajectory.alignment,
        cloud=surface.cloud,
        calls=calls.records,
        target=calls.target,
        method=method,
        findings=(*run.findings, *(finding for item in all_calls(run) for finding in item.findings)),
        processes=next((item.processes for item in run.stats if item.processes is not None), None),
        external=run.external,
        convention=run.convention,
        warnings=tuple(warnings),
        contradiction=trajectory.contradiction,
        errors=trajectory.errors,
        details=_details(trajectory.details, surface.details, calls.plots),
    )


def judged_with_warnings(score: Score, config: ScoreConfig, limits: Limits | None) -> Score:
    """Return a score with its verdicts, and with warnings of what the verdicts do not show."""
    score = judged(score, limits, partial=config.trajectory.partial)
    return struct_replace(score, warnings=(*score.warnings, *_partial_warnings(score), *reading_caveats(score)))


def _details(
    trajectory: TrajectoryDetails | None, cloud: MapDetails | None, calls: Mapping[str, CallPlots]
) -> Details | None:
    found = Details(trajectory=trajectory, map=cloud, calls=dict(calls))
    return None if found == Details() else found


def _partial_warnings(score: Score) -> Iterator[str]:
    """Yield what is missing of the whole that nothing but the user's consent lets pass."""
    if score.incomplete is None and (text := why_not_whole(score)) is not None:
        yield f"a part of the drive is judged: {text}"


def _convention_warnings(convention: ConventionRecord | None) -> Iterator[str]:
    if convention is not None and convention.diagnosed is not None:
        fitted = "; numbers of it were fitted to the truth, which flatters the figures" if convention.fitted else ""
        yield f"--apply-diagnosis converted the estimate by {convention.diagnosed} before scoring it{fitted}"


def all_calls(run: Run) -> list[CallStats]:
    """Return the calls of a run, those on this host before those on a target."""
    return [*run.stats, *([] if run.target is None else [run.target])]


def _method_of(run: Run) -> MethodRecord | None:
    """Return whose run it is; a method under test rather than the one of this suite beside it."""
    methods = [item.method for item in all_calls(run) if item.method is not None]
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


# ---- beside the score


def diagnose_run(inputs: ScoreInputs, config: ScoreConfig) -> Diagnosis:
    """Return which single convention mismatch explains how the trajectories of files disagree."""
    drive = load_run(inputs).drive
    if drive is None:
        raise MetricsError(f"'{inputs.truth}' and the estimate are no trajectories: a diagnosis requires poses")
    if not drive.truth.has_attitude:
        text = "has only positions: a convention mismatch cannot be detected from them"
        raise MetricsError(f"the truth '{inputs.truth}' {text}")
    return diagnose(drive.estimates.trajectory, drive.truth, config.trajectory.association, drive.rig)
