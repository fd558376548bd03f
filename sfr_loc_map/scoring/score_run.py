"""From a run to its score: trajectory, map, time, memory, verdicts."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from msgspec.structs import replace as struct_replace

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.arrays import IntArray
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.inputs import Task, hash_arrays
from sfr_loc_map.metrics.aligned_error import aligned_errors
from sfr_loc_map.metrics.calls import (
    KINDS_OF,
    ScoredCalls,
    completeness_of_answers,
    completeness_rows,
    concatenated,
    score_calls,
    score_target,
    with_external,
)
from sfr_loc_map.metrics.catalogue import DRIVE, MAP, Subject
from sfr_loc_map.metrics.cloud_error import PairTruth, score_map, score_nearest, typical_pixel_offset
from sfr_loc_map.metrics.completeness import expected_row, live_completeness, settled, share_rows
from sfr_loc_map.metrics.config import AlignedErrorConfig, AssociationMode, Condition, ScoreConfig, label_of
from sfr_loc_map.metrics.convention import Diagnosis, diagnose
from sfr_loc_map.metrics.incomplete import why_incomplete
from sfr_loc_map.metrics.judge import judged
from sfr_loc_map.metrics.limits import Limits
from sfr_loc_map.metrics.pose_convention import PoseConvention
from sfr_loc_map.metrics.row_part import Place, RowPart
from sfr_loc_map.metrics.score import (
    Alignment,
    Association,
    CallPlots,
    CallRecords,
    CloudRecord,
    ConventionRecord,
    Details,
    ErrorRows,
    Figure,
    MapDetails,
    MethodKind,
    MethodRecord,
    Provenance,
    Score,
    TargetRun,
    TrajectoryDetails,
    TruthRecord,
)
from sfr_loc_map.metrics.trajectory_score import score_trajectory
from sfr_loc_map.runs.calls import CallStats
from sfr_loc_map.scoring.contradiction import convention_mismatch
from sfr_loc_map.scoring.load import load_run
from sfr_loc_map.scoring.provenance import provenance_of
from sfr_loc_map.scoring.run import Correction, DriveToScore, Run, ScoreInputs

FEW_TRUE_POSES = 0.5  #: Below so many true poses an image it is said that frames count true poses.
OUTSIDE_SHARE, OUTSIDE_S = 0.5, 0.2  #: Processor time that is of no call from which it is said: share of all, s.
MAX_PIXEL_OFFSET = 5.0  #: Typical distance of points from the pixels that they name, px: matching errs by less.
MAX_EXCESS = 0.05  #: Share of the path of a truth that may be noise without a word.


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
    run: Run,
    config: ScoreConfig,
    limits: Limits | None = None,
    aligned: AlignedErrorConfig | None = None,
    kept_errors: Collection[tuple[str, str]] = (),
) -> Score:
    """Return the score of a run, also for conditions that only the limits name; with settings, APE and RPE as well.

    All errors are kept of the figures of the trajectory that are limited, and of `kept_errors`.
    """
    config = _with_conditions(config, limits)
    limited = frozenset() if limits is None else limits.figures_with_all_errors
    drive = _drive_part(run, config, aligned, limited.union(kept_errors))
    cloud = _map_part(run, config)
    calls = _calls_part(run)
    method = _method_of(run)
    warnings = [*_convention_warnings(run.convention), *drive.warnings]
    warnings += [*cloud.warnings, *calls.warnings]
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


def _provenance(run: Run, config: ScoreConfig, drive_sha256: str | None, map_sha256: str | None) -> Provenance | None:
    if run.under_way is not None:
        return run.under_way.provenance
    return provenance_of(run, config, drive_sha256, map_sha256)


def _partial_warnings(score: Score) -> Iterator[str]:
    """Yield what is missing of the whole that nothing but the user's consent lets pass."""
    if score.incomplete is None and (text := why_incomplete(struct_replace(score, rules=None))) is not None:
        yield f"a part of the drive is judged: {text}"


def _with_conditions(config: ScoreConfig, limits: Limits | None) -> ScoreConfig:
    """Return settings with the conditions that only the limits name."""
    present = [Condition.parse(text).setting for text in config.trajectory.conditions]
    missing = [] if limits is None else [item for item in limits.conditions if item not in present]
    conditions = (*config.trajectory.conditions, *missing)
    return replace(config, trajectory=replace(config.trajectory, conditions=conditions))


def _details(
    trajectory: TrajectoryDetails | None, cloud: MapDetails | None, calls: Mapping[str, CallPlots]
) -> Details | None:
    found = Details(trajectory=trajectory, map=cloud, calls=dict(calls))
    return None if found == Details() else found


# ---- the trajectory


def _drive_part(
    run: Run, config: ScoreConfig, aligned: AlignedErrorConfig | None, kept_errors: Collection[tuple[str, str]]
) -> _DrivePart:
    drive = run.drive
    if drive is None and run.unposed_images:
        many = run.unposed_images
        return _DrivePart(figures=(expected_row(RowPart(DRIVE), 0, many), *share_rows("missing", many, many)))
    if drive is None:
        return _DrivePart()
    live = run.under_way
    if live is None:
        association = config.trajectory.association
        contradiction = convention_mismatch(drive.estimates.trajectory, drive.truth, association, drive.rig)
    else:
        contradiction = live.contradiction
    scored = score_trajectory(
        drive.estimates,
        drive.truth,
        config.trajectory,
        image_stamps_ns=drive.image_stamps_ns,
        details=live is None or live.details,
        under_way=live is not None,
        in_flight_ns=0 if live is None else live.in_flight_ns,
        kept_errors=kept_errors,
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
        data_sha256=hash_arrays((drive.truth.stamps_ns, drive.truth.positions)) if live is None else None,
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
    yield f"{text} {first.name}{over}: {each} (displacement and position need an estimate that starts at a true pose)"


def truth_warnings(about: TruthRecord) -> Iterator[str]:
    """Yield what a score by this truth does not hold."""
    if not about.attitude:
        tilt = "" if about.tilt_deg is None else f", its z by {about.tilt_deg:.3g} deg,"
        yield (
            "the truth has positions alone: attitude and heading errors are not known; the estimate was turned by "
            f"{about.yaw_deg or 0.0:.3g} deg about z{tilt} and moved to fit it over the drive, so that attitude errors "
            "from before a sub-trajectory count in its position error (chord errors need no fit)"
        )
    if not (about.height and about.tilt):
        names = [name for name, is_known in (("height", about.height), ("roll and pitch", about.tilt)) if not is_known]
        judged = [] if about.height else ["horizontal position errors are judged in place of position errors"]
        judged += [] if about.tilt else ["attitude errors are unknown, and roll and pitch are those of the estimate"]
        yield f"the truth does not know {' and '.join(names)}: {'; '.join(judged)}"
    if about.path_excess is not None and about.path_excess > MAX_EXCESS:
        yield (
            f"the noise of the truth ({about.sigma_m:.3g} m) lengthens its path by about "
            f"{100.0 * about.path_excess:.3g} %: a sub-trajectory distance=METRES ends too early; give "
            "displacement=METRES, or a smoothed truth"
        )


# ---- the map


def _map_part(run: Run, config: ScoreConfig) -> _MapPart:
    if (live := run.under_way) is not None:
        made = live.scored_map
        if made is None:
            return _MapPart()
        return _MapPart(figures=made.figures, cloud=made.cloud, details=made.details if live.details else None)
    if run.cloud is None and run.unmapped_pairs:
        many = run.unmapped_pairs
        return _MapPart(figures=(expected_row(RowPart(MAP), 0, many), *share_rows("pairs_without_cloud", many, many)))
    if run.cloud is None:
        return _MapPart()
    loaded, truths = run.cloud.loaded, run.cloud.truths
    pairs = None if run.nav_stamps_ns is None else len(np.unique(run.nav_stamps_ns))
    if loaded.cloud is None:
        scored = score_nearest(loaded.xyz, truths, config.map, expected_pairs=pairs, not_finite=loaded.not_finite)
    else:
        scored = score_map(loaded.cloud, truths, config.map, expected_pairs=pairs, not_finite=loaded.not_finite)
    return _MapPart(
        warnings=() if loaded.cloud is None else tuple(_pixel_warnings(loaded.cloud, truths)),
        figures=scored.figures,
        cloud=scored.cloud,
        details=scored.details,
        data_sha256=hash_arrays(truth.points for truth in truths),
    )


def _pixel_warnings(cloud: PointCloud, truths: Sequence[PairTruth]) -> Iterator[str]:
    """Yield that points are not seen at the pixels that they name."""
    offset_px = typical_pixel_offset(cloud, truths)
    if offset_px > MAX_PIXEL_OFFSET:
        yield (
            f"the points of the cloud are typically {offset_px:.3g} px from the pixels that they name: the pixels are "
            "of images of another size or of another pair, or the points are in another frame than LM; errors are "
            "those at the named pixels (a cloud of x, y, z alone is scored by the nearest true point)"
        )


# ---- the calls


def _calls_part(run: Run) -> _CallsPart:
    live = run.under_way
    every = [concatenated([item.calls for item in run.stats])] if run.stats else []
    details = live is None or live.details
    of_host = score_calls(every[0], details=details) if every else ScoredCalls()
    if run.external is not None:
        of_host = with_external(of_host, run.external)
    records = of_host.records if run.stats or run.external is not None else None
    expected = _expected_calls(run)
    figures = [*of_host.figures, *completeness_rows(every, expected)]
    if live is not None and (live.dropped or live.restarts):
        figures += live_completeness(live.received, live.dropped, live.restarts)
    if (node := run.external) is not None:
        kinds = KINDS_OF[Task(node.task)]
        others = [row for row in figures if row.subject is not Subject.COMPLETENESS or row.call not in kinds]
        figures = [*others, *completeness_of_answers(node)]
    if run.target is None:
        return _CallsPart(figures=tuple(figures), records=records, plots=of_host.plots)
    of_target, target = _scored_target(run, run.target)
    expected = expected if run.target.has_stamps else {}  # calls without stamps are of no known pair
    figures += [*of_target, *completeness_rows([run.target.calls], expected, Place.TARGET)]
    warnings = tuple(_target_warnings(target))
    return _CallsPart(figures=tuple(figures), records=records, plots=of_host.plots, target=target, warnings=warnings)


def _expected_calls(run: Run) -> dict[Task, IntArray | None]:
    """Return the stamps of the pairs that each task has a call for: those of the source, else of the truth.

    While a run goes on, the calls of the last pairs may still come.
    """
    images = None if run.drive is None else run.drive.image_stamps_ns
    if images is None and run.drive is not None:
        images = run.drive.truth.stamps_ns
    expected = {Task.LOCALISATION: images, Task.MAPPING: run.nav_stamps_ns}
    if (live := run.under_way) is None or not run.stats:
        return expected
    calls = concatenated([item.calls for item in run.stats])
    is_localisation = calls.is_localisation
    of_task = {Task.LOCALISATION: calls.stamps_ns[is_localisation], Task.MAPPING: calls.stamps_ns[~is_localisation]}
    return {
        task: None if stamps is None else settled(stamps, of_task[task], live.in_flight_ns)
        for task, stamps in expected.items()
    }


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
