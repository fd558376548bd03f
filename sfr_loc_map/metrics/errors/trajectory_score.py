"""The trajectory score: association, sub-trajectories, errors and statistics [4.1, 4.2.3].

The formulas are in `metrics.formulas`. The same function scores files and live runs.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.arrays import IntArray
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.message_text import counted
from sfr_loc_map.metrics import formulas
from sfr_loc_map.metrics.completeness.copies import copy_rows, judged_of_truth
from sfr_loc_map.metrics.completeness.drive import drive_completeness
from sfr_loc_map.metrics.config import Condition, Reading, TrajectoryScoreConfig
from sfr_loc_map.metrics.errors.consistency import StepSums, nees_rows, sums_of_steps
from sfr_loc_map.metrics.errors.other_frames import largest_fraction_beyond, rows_of_other_frames, unjudged_frames
from sfr_loc_map.metrics.errors.plot_columns import path_rows, sub_trajectory_rows
from sfr_loc_map.metrics.errors.standing import largest_standing_fraction, rows_of_moving
from sfr_loc_map.metrics.errors.three_sigma import confidence_rows
from sfr_loc_map.metrics.errors.trajectory_errors import (
    error_figures,
    error_rows,
    errors_of,
    growth_rows,
    overlap_of,
    select,
)
from sfr_loc_map.metrics.frames.association import Estimates, Frames
from sfr_loc_map.metrics.frames.placement import (
    ERROR_FUNCTIONS,
    PlacedFrames,
    Placement,
    placed_frames,
    without_unknown_attitudes,
)
from sfr_loc_map.metrics.frames.truth_error import as_truth, truth_error_rows, turn_rows
from sfr_loc_map.metrics.sub_trajectories import SubTrajectories
from sfr_loc_map.metrics.table.details import ErrorRows, SubTrajectoryRows, TrajectoryDetails, column
from sfr_loc_map.metrics.table.records import Association, TruthRecord
from sfr_loc_map.metrics.table.results import TrajectoryResult
from sfr_loc_map.metrics.table.rows import Figure


def score_trajectory(
    estimates: Estimates,
    truth: Trajectory,
    config: TrajectoryScoreConfig,
    *,
    image_stamps_ns: IntArray | None = None,
    details: bool = True,
    is_live: bool = False,
    in_flight_ns: int = 0,
    kept_errors: Collection[tuple[str, str]] = (),
) -> TrajectoryResult:
    """Return the score of a trajectory, given as poses of RB in DS in any order.

    An estimate has to cover the images, or the true poses if the stamps of the images are unknown. Results of the last
    `in_flight_ns` are not required yet. `kept_errors` are the limited figures and their conditions, whose errors are
    all kept. With `details`, the frames are kept for plots as well. MetricsError if a condition is invalid, or if no
    estimate has a ground truth, unless the run `is_live`: what a live run received is always scored.
    """
    conditions = parsed_conditions(config)
    placed = placed_frames(estimates, truth, conditions, config, image_stamps_ns)
    if not placed.association.matched and not is_live:
        raise MetricsError(nothing_matched(estimates.trajectory, truth))
    frames = placed.frames
    chosen = list(sub_trajectories_of(conditions, placed, config.spacing))
    association, completeness = completeness_of_drive(
        estimates.trajectory, truth, placed, chosen, image_stamps_ns, in_flight_ns
    )
    sums = step_sums(placed.estimates, frames, [(item.starts, item.ends) for item in chosen])
    results = [result_of_condition(item, placed, truth, config.spacing, sums, kept_errors) for item in chosen]
    figures = [row for result in results for row in result.figures]
    figures += largest_fraction_beyond(figures)
    figures.append(largest_standing_fraction(figures))
    has_height = as_truth(truth).has_height
    figures += growth_rows(placed.poses, placed.length_m, config.spacing, placed.error_function, has_height=has_height)
    figures += truth_error_rows(truth, frames.stamps_ns if association.interpolated else frames.stamps_ns[:0])
    path = path_rows(placed.estimates, frames, placed.length_m) if details else None
    return TrajectoryResult(
        figures=(*figures, *completeness),
        association=association,
        truth=truth_record(truth, frames, placed.placement),
        details=TrajectoryDetails(path=path, sub_trajectories=tuple(result.rows for result in results)),
        errors=tuple(errors for result in results for errors in result.errors),
        unjudged=tuple(text for result in results for text in result.unjudged),
    )


class ChosenStarts(NamedTuple):
    """The sub-trajectories of a condition, as frames."""

    condition: Condition
    starts: IntArray
    ends: IntArray


class ConditionResult(NamedTuple):
    """The part of a score from the sub-trajectories of one condition."""

    figures: tuple[Figure, ...]
    rows: SubTrajectoryRows  #: Data of the plots.
    errors: tuple[ErrorRows, ...]  #: All errors of the figures that limits require.
    unjudged: tuple[str, ...]  #: Warnings of frames that are in no judged error and whose errors are far larger.


def sub_trajectories_of(conditions: Sequence[Condition], placed: PlacedFrames, spacing: int) -> Iterator[ChosenStarts]:
    """Yield the sub-trajectories of each condition."""
    for condition in conditions:
        yield ChosenStarts(condition, *select(condition, spacing, placed.frames.truth, placed.length_m))


def completeness_of_drive(
    estimate: Trajectory,
    truth: Trajectory,
    placed: PlacedFrames,
    chosen: Sequence[ChosenStarts],
    image_stamps_ns: IntArray | None,
    in_flight_ns: int,
) -> tuple[Association, list[Figure]]:
    """Return the association with the number of images, and all rows of completeness of a drive."""
    frames = placed.frames
    conditions = [item.condition for item in chosen]
    association, rows = drive_completeness(
        estimate, truth, placed.association, frames.stamps_ns, conditions, image_stamps_ns, in_flight_ns
    )
    is_reported = (placed.estimates.lost | placed.estimates.degraded)[frames.estimate_rows]
    rows += copy_rows(frames, truth, is_reported, interpolated=association.interpolated > 0)
    rows.append(judged_of_truth(frames, [(item.starts, item.ends) for item in chosen]))
    return association, rows


def result_of_condition(
    chosen: ChosenStarts,
    placed: PlacedFrames,
    truth: Trajectory,
    spacing: int,
    sums: Mapping[int, StepSums],
    kept_errors: Collection[tuple[str, str]],
) -> ConditionResult:
    """Return the part of a score from the sub-trajectories of one condition."""
    condition, starts, ends = chosen
    name = condition.setting
    known = as_truth(truth)
    sub_trajectories = SubTrajectories(starts, ends, placed.poses, placed.error_function(placed.poses, starts, ends))
    overlap = overlap_of(starts, ends, spacing)
    of_other_frames = tuple(rows_of_other_frames(name, sub_trajectories, placed, has_height=known.has_height))
    of_moving = rows_of_moving(
        condition, sub_trajectories, overlap, has_height=known.has_height, has_tilt=known.has_tilt
    )
    return ConditionResult(
        figures=(
            *error_rows(name, sub_trajectories, overlap, placed, truth),
            *consistency_rows(name, sub_trajectories, overlap, placed, truth, sums),
            *of_other_frames,
            *of_moving,
        ),
        rows=sub_trajectory_rows(name, sub_trajectories, placed.frames.stamps_ns, placed.length_m),
        errors=tuple(error_columns(name, sub_trajectories, kept_errors)),
        unjudged=tuple(unjudged_frames(name, sub_trajectories, placed, of_other_frames)),
    )


def parsed_conditions(config: TrajectoryScoreConfig) -> list[Condition]:
    """Return the conditions of the settings, each once; MetricsError if there are none."""
    if not config.conditions:
        raise MetricsError("no condition of a sub-trajectory given: give at least one, such as distance=5")
    return list(dict.fromkeys(Condition.parse(text) for text in config.conditions))


def nothing_matched(estimate: Trajectory, truth: Trajectory) -> str:
    """Return the error message for an estimate that has no ground truth at its stamps."""
    spans = []
    for poses in (estimate, truth):
        stamps = poses.stamps_ns
        span = f" from {min(stamps) / NS_PER_S:.3f} s to {max(stamps) / NS_PER_S:.3f} s" if len(stamps) else ""
        spans.append(f"{counted(len(stamps), 'pose')}{span}")
    return (
        f"no estimate has a ground truth at its stamp: the estimate has {spans[0]}, the ground truth has {spans[1]}; "
        "give trajectories of the same drive and clock (sfr score --diagnose estimates the offset of the stamps)"
    )


def consistency_rows(
    condition: str,
    sub_trajectories: SubTrajectories,
    overlap: float,
    placed: PlacedFrames,
    truth: Trajectory,
    sums: Mapping[int, StepSums],
) -> Iterator[Figure]:
    """Yield the rows of one condition that relate the errors to their distribution, the truth and the covariances."""
    known = as_truth(truth)
    if placed.association.rebase is Reading.POSE:
        yield from turn_rows(condition, known.sigma_deg, sub_trajectories.true_displacement())
    if known.has_height:
        yield from confidence_rows(condition, sub_trajectories.errors.position_m, overlap)
    if known.has_height and known.has_tilt:
        noise = (known.sigma_m, known.sigma_deg)
        yield from nees_rows(
            condition, placed.estimates, placed.frames, sums, sub_trajectories.starts, sub_trajectories.ends, noise
        )


def error_columns(
    condition: str, sub_trajectories: SubTrajectories, kept_errors: Collection[tuple[str, str]]
) -> Iterator[ErrorRows]:
    """Yield all errors of the figures in `kept_errors` over a condition."""
    for kind in error_figures(has_height=False):
        if (kind.name, condition) in kept_errors:
            columns = tuple(column(values, None) for values in np.atleast_2d(errors_of(kind, sub_trajectories).T))
            yield ErrorRows(figure=kind.name, condition=condition, errors=columns)


def step_sums(estimates: Estimates, frames: Frames, chosen: Sequence[tuple[IntArray, IntArray]]) -> dict[int, StepSums]:
    """Return the sums of steps up to each estimate at which a sub-trajectory starts or ends, by estimate.

    The result is empty if the estimates have no covariances of steps.
    """
    if estimates.steps is None or estimates.covariance is None:
        return {}
    compared = np.unique(np.concatenate([np.concatenate(pair) for pair in chosen]))
    return sums_of_steps(estimates, estimates.steps, frames.estimate_rows[compared])


def truth_record(truth: Trajectory, frames: Frames, placement: Placement | None) -> TruthRecord:
    """Return the properties of the ground truth."""
    known = as_truth(truth)
    steps = np.linalg.norm(np.diff(frames.true_position, axis=0), axis=1)
    step = float(np.median(steps)) if len(steps) else 0.0
    return TruthRecord(
        attitude=truth.has_attitude,
        height=known.has_height,
        tilt=known.has_tilt,
        sigma_m=known.sigma_m or None,
        sigma_deg=known.sigma_deg or None,
        path_excess=2.0 * (known.sigma_m / step) ** 2 if known.sigma_m and step else None,
        lever_arm_m=known.lever_arm_m if any(known.lever_arm_m) else (),
        declared=known.declared,
        yaw_deg=None if placement is None else placement.yaw_deg,
        tilt_deg=None if placement is None else placement.tilt_deg,
        translation_m=() if placement is None else placement.translation_m,
    )


# ---- raw values, from which each figure can be recomputed


def sub_trajectory_table(
    estimates: Estimates, truth: Trajectory, config: TrajectoryScoreConfig, image_stamps_ns: IntArray | None = None
) -> dict[str, NDArray[Any]]:
    """Return every sub-trajectory of each condition, as columns of equal length.

    Each row contains the errors by one reading of the specification (`ERROR_FUNCTIONS`). `start_frame` and `end_frame`
    are indices of frames. The error vector is the estimated displacement, as this reading compares it, minus the true
    displacement. Errors are raised as by `score_trajectory`.
    """
    conditions = parsed_conditions(config)
    placed = placed_frames(estimates, truth, conditions, config, image_stamps_ns)
    frames = placed.frames
    poses = placed.poses
    length_m = placed.length_m
    functions = {placed.association.rebase: placed.error_function}
    if truth.has_attitude:
        known = as_truth(truth)
        functions |= {reading: without_unknown_attitudes(known, each) for reading, each in ERROR_FUNCTIONS.items()}
    parts: list[dict[str, NDArray[Any]]] = []
    for condition, starts, ends in sub_trajectories_of(conditions, placed, config.spacing):
        true_move = formulas.displacement(poses.true_position, starts, ends)
        for reading, function in functions.items():
            errors = function(poses, starts, ends)
            part: dict[str, NDArray[Any]] = {
                "condition": np.full(len(starts), condition.setting, object),
                "reading": np.full(len(starts), str(reading), object),
                "start_frame": starts,
                "end_frame": ends,
                "start_stamp_ns": frames.stamps_ns[starts],
                "end_stamp_ns": frames.stamps_ns[ends],
                "travelled_m": np.asarray(length_m[ends] - length_m[starts], np.float64),
            }
            for axis, values in zip("xyz", true_move.T, strict=True):
                part[f"true_displacement_{axis}_m"] = values
            for axis, values in zip("xyz", (true_move + errors.position_m).T, strict=True):
                part[f"estimated_displacement_{axis}_m"] = values
            for axis, values in zip("xyz", errors.position_m.T, strict=True):
                part[f"error_{axis}_m"] = values
            part["attitude_error_deg"] = errors.attitude_deg
            part["heading_error_deg"] = errors.heading_deg
            parts.append(part)
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
