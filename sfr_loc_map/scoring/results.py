"""The results of the trajectory, the map and the calls of a run, for files and live runs.

`metrics.figures.results` defines the results. The functions take values and are independent of the source of the run.
`score_run` (a finished run) and `live_score.score_so_far` (a run in progress) compute the results, and
`assembly.score_of_results` makes a score of them.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from msgspec.structs import replace as struct_replace

from sfr_loc_map.calls.call_stats import CallStats
from sfr_loc_map.geometry.arrays import IntArray
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.trajectory import as_truth
from sfr_loc_map.metrics.calls.call_meter import HOST_CLOCK
from sfr_loc_map.metrics.calls.call_score import STATED_BY_NODE, Measurement, score_calls, score_target, with_external
from sfr_loc_map.metrics.calls.calls import KINDS_OF, concatenated
from sfr_loc_map.metrics.completeness.drive import SPARSER, rows_without_poses
from sfr_loc_map.metrics.completeness.expected_items import rows_without_cloud
from sfr_loc_map.metrics.config import (
    AlignedErrorConfig,
    AssociationMode,
    CallKind,
    MapScoreConfig,
    TrajectoryScoreConfig,
)
from sfr_loc_map.metrics.figures.records import Association, ExternalScore, MethodKind, TargetRun
from sfr_loc_map.metrics.figures.results import CallsResult, MapResult, TrajectoryResult
from sfr_loc_map.metrics.figures.row_part import Place
from sfr_loc_map.metrics.map.map_score import score_map, score_nearest
from sfr_loc_map.metrics.map.pair_truth import PairTruth
from sfr_loc_map.metrics.map.point_errors import typical_pixel_offset
from sfr_loc_map.metrics.score.caveats import truth_caveats
from sfr_loc_map.metrics.trajectory.aligned_error import aligned_errors
from sfr_loc_map.metrics.trajectory.trajectory_score import score_trajectory
from sfr_loc_map.scoring.conversion import ConventionFinding
from sfr_loc_map.scoring.inputs import DriveToScore, Run, TargetCalls
from sfr_loc_map.scoring.placeholders import placeholder_warnings, stationary_truth_warnings
from sfr_loc_map.suite_names import Task

FEW_TRUE_POSES = 1.0 / SPARSER  #: A truth is reported as sparse up to this ratio of true poses to images.
ESTIMATES_OF_PART = 20  #: Mean number of estimates in a part of a drive whose rate of estimates is compared.
MAX_UNEVEN = 0.05
"""Largest accepted fraction of the estimates by which the denser parts of a drive exceed their fraction of the time. A
rate that doubles in half of the drive has an excess of 1/6."""
MAX_PIXEL_OFFSET = 5.0  #: Maximum typical reprojection error of points, px. Matching errors are smaller.


# ---- the trajectory


def trajectory_result(
    run: Run,
    config: TrajectoryScoreConfig,
    finding: ConventionFinding | None,
    kept_errors: Collection[tuple[str, str]],
    *,
    details: bool = True,
    is_live: bool = False,
    in_flight_ns: int = 0,
) -> TrajectoryResult:
    """Return the result of a trajectory; `finding` is about the conventions of estimate and truth.

    If the run has no estimates, the result contains the images without an estimate. A live run is scored even if no
    estimate has a ground truth. Results of the last `in_flight_ns` may still arrive.
    """
    if run.drive is None:
        images = run.expected.unposed_images
        return TrajectoryResult(figures=tuple(rows_without_poses(images)) if images else ())
    drive = run.drive
    scored = score_trajectory(
        drive.estimates,
        drive.truth,
        config,
        image_stamps_ns=drive.image_stamps_ns,
        details=details,
        is_live=is_live,
        in_flight_ns=in_flight_ns,
        kept_errors=kept_errors,
    )
    estimate = drive.estimates.trajectory
    warnings: list[str] = []
    if finding is not None:
        warnings.append(finding.text)
    else:
        warnings += stationary_truth_warnings(estimate, drive.truth)
    warnings += _sparse_truth(drive, scored.association)
    warnings += placeholder_warnings(estimate, drive.truth)
    warnings += truth_caveats(scored.truth)
    about_truth = (f"ground truth: {text}" for text in as_truth(drive.truth).findings)
    caveats = (*drive.caveats, *about_truth, *_uneven_estimates(drive, scored.association))
    contradiction = finding.text if finding is not None and finding.prevents_verdict else None
    return replace(scored, warnings=tuple(warnings), caveats=caveats, contradiction=contradiction)


def with_aligned_errors(result: TrajectoryResult, drive: DriveToScore, config: AlignedErrorConfig) -> TrajectoryResult:
    """Return the result of a drive with APE and RPE."""
    beside = aligned_errors(drive.estimates.trajectory, drive.truth, config)
    return replace(result, figures=(*result.figures, *beside.figures), alignment=beside.alignment)


def _uneven_estimates(drive: DriveToScore, association: Association) -> Iterator[str]:
    """Yield a caveat if the rate of the estimates varies over the drive and the images are unknown."""
    if association.images is not None:
        return
    excess = excess_of_dense_parts(drive.estimates.trajectory.stamps_ns)
    if excess > MAX_UNEVEN:
        yield (
            "the rate of the estimates varies over the drive and the images are unknown: its denser parts contain a "
            f"fraction of the estimates that exceeds their fraction of the time by {100.0 * excess:.3g} %, so that "
            "frames of denser parts have more weight in the figures; score against the source with its images"
        )


def _sparse_truth(drive: DriveToScore, association: Association) -> Iterator[str]:
    """Yield a warning if the frames are the poses of a truth that is sparser than the images or estimates."""
    expected, what = association.images, "images"
    if expected is None:
        expected, what = len(drive.estimates.trajectory), "estimates"
    if association.mode is AssociationMode.MATCH and association.truth_poses <= FEW_TRUE_POSES * expected:
        yield (
            f"the truth has only {association.truth_poses} poses for {expected} {what}: only these are scored, errors "
            "between them are not in the figures, and --spacing and conditions of frames count true poses; sfr score "
            "--frames images interpolates the truth to every image"
        )


def excess_of_dense_parts(stamps_ns: IntArray) -> float:
    """Return how unevenly the estimates are distributed over time.

    The result is the fraction of the estimates in the denser parts of the drive, minus the fraction of the time that
    these parts take. The time is divided into equal parts with `ESTIMATES_OF_PART` estimates on average. At a constant
    rate the result is 0.
    """
    stamps = np.unique(stamps_ns)
    if len(stamps) < 2:
        return 0.0
    parts = max(len(stamps) // ESTIMATES_OF_PART, 2)
    edges = np.linspace(0.0, float(stamps[-1] - stamps[0]), parts + 1)
    number_at_edges = np.interp(edges, (stamps - stamps[0]).astype(np.float64), np.arange(len(stamps)))
    of_parts = np.diff(number_at_edges) / (len(stamps) - 1)
    return float(np.maximum(of_parts - 1.0 / parts, 0.0).sum())


# ---- the map


def map_result(run: Run, config: MapScoreConfig) -> MapResult:
    """Return the result of a map; if the run has no cloud, the result contains the mapping pairs without a cloud."""
    pairs = run.expected.mapping_pairs
    if run.cloud is None:
        return result_without_cloud(run.expected.unmapped, pairs)
    loaded = run.cloud.loaded
    truths = run.cloud.truths
    if loaded.cloud is None:
        return score_nearest(loaded.xyz, truths, config, expected_pairs=pairs, not_finite=loaded.not_finite)
    found = score_map(loaded.cloud, truths, config, expected_pairs=pairs, not_finite=loaded.not_finite)
    return replace(found, warnings=tuple(_pixel_warnings(loaded.cloud, truths)))


def result_without_cloud(unmapped: int, pairs: int | None) -> MapResult:
    """Return the result without a cloud that can be scored.

    `unmapped` of the `pairs` are in no cloud. If `pairs` is None, only the unmapped pairs count as expected.
    """
    if not unmapped:
        return MapResult()
    return MapResult(figures=tuple(rows_without_cloud(unmapped, unmapped if pairs is None else pairs)))


def _pixel_warnings(cloud: PointCloud, truths: Sequence[PairTruth]) -> Iterator[str]:
    """Yield a warning if points do not reproject to the pixels that they name."""
    offset_px = typical_pixel_offset(cloud, truths)
    if offset_px > MAX_PIXEL_OFFSET:
        yield (
            f"the points of the cloud are typically {offset_px:.3g} px from the pixels that they name: "
            "these pixels belong to another image size or another pair, or the points are not in frame LM; errors are "
            "computed at the named pixels (a cloud with only x, y, z is scored by the nearest true point)"
        )


# ---- the calls


def calls_result(run: Run, expected_ns: Mapping[Task, IntArray | None], *, details: bool = True) -> CallsResult:
    """Return the result of the calls; `expected_ns` are the stamps of the pairs that should have a call.

    An external node is measured from outside, and what it states about its own calls is not judged.
    """
    node = run.item.external
    scored = CallsResult()
    if run.stats:
        calls = concatenated([item.calls for item in run.stats])
        scored = score_calls(calls, expected_ns, measurements_of(run.stats, node), details=details)
    if node is not None:
        scored = with_external(scored, node)
    if run.target is not None:
        scored = with_target(scored, run, run.target, expected_ns)
    return scored


def measurements_of(stats: Sequence[CallStats], node: ExternalScore | None) -> dict[CallKind, Measurement]:
    """Return how each kind of call was measured; `node` is the external node of a replay, None without one.

    The times of a task come from the node itself if its messages stated them (`CallStats.stated_tasks`). The calls that
    an external node states have the place `stated`, because they were not measured from outside.
    """
    found: dict[CallKind, Measurement] = {}
    for task in Task:
        is_stated = any(task in item.stated_tasks for item in stats)
        is_external = has_external_method(stats, task) if node is None else Task(node.task) is task
        measurement = Measurement(
            place=Place.STATED if is_external else Place.HOST, clock=STATED_BY_NODE if is_stated else HOST_CLOCK
        )
        found |= dict.fromkeys(KINDS_OF[task], measurement)
    return found


def has_external_method(stats: Sequence[CallStats], task: Task) -> bool:
    """Return whether calls of a task are those of an external node."""
    methods = [item.methods[task] for item in stats if task in item.methods and item.has_task(task)]
    return any(method.kind is MethodKind.EXTERNAL for method in methods)


def with_target(
    scored: CallsResult, run: Run, target: TargetCalls, expected_ns: Mapping[Task, IntArray | None]
) -> CallsResult:
    """Return the result of other calls with the rows of the calls on a target."""
    calls = target.calls
    stamps_ns = None if run.drive is None else run.drive.estimates.trajectory.stamps_ns
    rows, record = score_target(
        calls.calls, target.name, expected_ns, stamps_ns, has_stamps=calls.has_stamps, other_run=target.other_run
    )
    record = struct_replace(record, about=target.about)
    figures = (*scored.figures, *rows)
    return replace(scored, figures=figures, target=record, caveats=tuple(_target_caveats(record)))


def expected_calls(run: Run) -> dict[Task, IntArray | None]:
    """Return the stamps of the pairs that should have a call, by task.

    If the image stamps of a drive are unknown, localisation calls are expected at the stamps of the truth.
    """
    images = None if run.drive is None else run.drive.image_stamps_ns
    if images is None and run.drive is not None:
        images = run.drive.truth.stamps_ns
    return {Task.LOCALISATION: images, Task.MAPPING: run.expected.nav_stamps_ns}


def _target_caveats(target: TargetRun) -> Iterator[str]:
    if target.other_run is not None:
        yield f"the times of {target.name} belong to another run: {target.other_run}"
    elif target.matched_share is not None and target.matched_share < 1.0:
        yield f"the times of {target.name} cover only {100.0 * target.matched_share:.3g} % of the estimates"
