"""The trajectory score [4.1, 4.2.3]: associate, select, compute the errors, summarise (`score_trajectory`).

The formulas are in `metrics.formulas`. The same function scores files and live runs. `metrics.judging` judges the rows.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.arrays import IntArray
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.message_text import counted
from sfr_loc_map.metrics.completeness.copies import copy_rows, judged_of_truth
from sfr_loc_map.metrics.completeness.drive import drive_completeness
from sfr_loc_map.metrics.conditions import Condition
from sfr_loc_map.metrics.config import Reading, TrajectoryScoreConfig
from sfr_loc_map.metrics.figures.catalogue import ERRORS_BEYOND, STANDING
from sfr_loc_map.metrics.figures.details import ErrorRows, SubTrajectoryRows, TrajectoryDetails, column
from sfr_loc_map.metrics.figures.records import Association, TruthRecord
from sfr_loc_map.metrics.figures.results import ScoredTrajectory
from sfr_loc_map.metrics.figures.rows import Figure, figure_row
from sfr_loc_map.metrics.frames.association import Estimates, unordered
from sfr_loc_map.metrics.frames.placement import PlacedFrames, placed_frames
from sfr_loc_map.metrics.sub_trajectories import SubTrajectories
from sfr_loc_map.metrics.trajectory.consistency import StepSums, nees_rows, sums_of_steps
from sfr_loc_map.metrics.trajectory.other_frames import rows_of_other_frames, to_other_frames, unjudged_frames
from sfr_loc_map.metrics.trajectory.plot_columns import path_rows, sub_trajectory_rows
from sfr_loc_map.metrics.trajectory.standing import rows_of_moving
from sfr_loc_map.metrics.trajectory.trajectory_errors import (
    all_error_figures,
    confidence_rows,
    error_rows,
    errors_of,
    growth_rows,
    largest_fraction,
    overlap_of,
    select,
)
from sfr_loc_map.metrics.trajectory.truth_error import truth_error_rows, turn_rows


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
) -> ScoredTrajectory:
    """Return the score of a trajectory, given as poses of RB in DS in any order.

    An estimate has to cover the images, or the true poses if the stamps of the images are unknown. Results of the last
    `in_flight_ns` are not required yet. `kept_errors` names the figures and conditions of which all errors are
    kept. With `details`, the frames are kept for plots as well.

    MetricsError if there is no condition, if a condition `turn` has a truth without roll and pitch, if the estimate has
    no attitudes, or if the estimate or the truth contains two runs. MetricsError also if no estimate has a ground
    truth, unless the run `is_live`, because what a live run received is always scored.
    """
    # associate
    conditions = parsed_conditions(config)
    placed = placed_frames(estimates, truth, conditions, config, image_stamps_ns)
    if not len(placed.frames.stamps_ns) and not is_live:
        raise MetricsError(nothing_matched(estimates.trajectory, truth))
    stamps_ns = placed.frames.stamps_ns
    drive = drive_completeness(estimates.trajectory, placed, conditions, image_stamps_ns, in_flight_ns)

    # select the sub-trajectories of each condition, and compute their errors by the judged reading
    selected = selected_sub_trajectories(conditions, placed, config.spacing)

    # summarise
    sums = step_sums(placed, selected.values())
    figures: list[Figure] = []
    plotted: list[SubTrajectoryRows] = []
    errors: list[ErrorRows] = []
    unjudged: list[str] = []
    for condition, chosen in selected.items():
        name = condition.setting
        overlap = overlap_of(chosen.starts, chosen.ends, config.spacing)
        others = to_other_frames(chosen, placed)
        of_other_frames = list(rows_of_other_frames(name, chosen, others, placed))
        figures += error_rows(name, chosen, overlap, placed)
        figures += consistency_rows(name, chosen, overlap, placed, sums)
        figures += of_other_frames
        figures += rows_of_moving(condition, chosen, overlap, placed.truth, stamps_ns)
        plotted.append(sub_trajectory_rows(name, chosen, stamps_ns, placed.length_m))
        errors += error_columns(name, chosen, kept_errors)
        unjudged += unjudged_frames(name, chosen, others, len(stamps_ns), of_other_frames)
    figures += list(rows_over_conditions(figures))
    figures += growth_rows(placed, config.spacing)
    figures += truth_error_rows(placed.truth, interpolated_stamps(placed))
    figures += drive.rows
    figures += rows_of_copies(placed, selected.values())
    path = path_rows(placed.estimates, placed.frames, placed.length_m) if details else None
    return ScoredTrajectory(
        figures=tuple(figures),
        association=association_record(placed, config.spacing, drive.images),
        truth=truth_record(placed),
        details=TrajectoryDetails(path=path, sub_trajectories=tuple(plotted)),
        errors=tuple(errors),
        unjudged=tuple(unjudged),
    )


# ---- selection


def parsed_conditions(config: TrajectoryScoreConfig) -> list[Condition]:
    """Return the conditions of the settings, each once; MetricsError if there are none."""
    if not config.conditions:
        raise MetricsError("no condition of sub-trajectories is given: give at least one, such as distance=5")
    return list(dict.fromkeys(Condition.parse(text) for text in config.conditions))


def selected_sub_trajectories(
    conditions: Sequence[Condition], placed: PlacedFrames, spacing: int
) -> dict[Condition, SubTrajectories]:
    """Return the sub-trajectories of each condition, with their errors by the judged reading."""
    return {
        condition: placed.sub_trajectories(*select(condition, spacing, placed.frames.truth, placed.length_m))
        for condition in conditions
    }


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


# ---- rows


def rows_over_conditions(of_conditions: Sequence[Figure]) -> Iterator[Figure]:
    """Yield the largest fractions over the conditions.

    They are the fractions of frames with far larger errors, and of sub-trajectories that a stationary rover adds.
    """
    if (beyond := largest_fraction(of_conditions, ERRORS_BEYOND)) is not None:
        yield beyond
    yield largest_fraction(of_conditions, STANDING) or figure_row(STANDING, n=0)


def interpolated_stamps(placed: PlacedFrames, frames: IntArray | slice = slice(None)) -> IntArray:
    """Return the stamps of all given frames if the truth was interpolated at any frame, otherwise none."""
    stamps_ns = placed.frames.stamps_ns[frames]
    return stamps_ns if placed.matched.interpolated else stamps_ns[:0]


def consistency_rows(
    condition: str, judged: SubTrajectories, overlap: float, placed: PlacedFrames, sums: Mapping[int, StepSums]
) -> Iterator[Figure]:
    """Yield the rows of one condition: rotation error of the truth, confidence of the errors, and NEES."""
    truth = placed.truth
    if placed.reading is Reading.POSE:
        starts_ns = interpolated_stamps(placed, judged.starts)
        yield from turn_rows(condition, truth, starts_ns, judged.true_displacement())
    if truth.has_height:
        yield from confidence_rows(condition, judged.errors.position_m, overlap)
    if truth.has_height and truth.has_tilt:
        noise = (truth.sigma_m, truth.sigma_deg)
        yield from nees_rows(condition, placed.estimates, placed.frames, sums, judged.starts, judged.ends, noise)


def error_columns(
    condition: str, sub_trajectories: SubTrajectories, kept_errors: Collection[tuple[str, str]]
) -> Iterator[ErrorRows]:
    """Yield all errors of the figures in `kept_errors` over a condition."""
    for kind in all_error_figures():
        if (kind.name, condition) in kept_errors:
            columns = tuple(column(values, None) for values in np.atleast_2d(errors_of(kind, sub_trajectories).T))
            yield ErrorRows(figure=kind.name, condition=condition, errors=columns)


def rows_of_copies(placed: PlacedFrames, selected: Collection[SubTrajectories]) -> Iterator[Figure]:
    """Yield the rows of the poses and of the selected motions that are copies of the truth or of the previous pose."""
    frames = placed.frames if placed.truth.has_height else placed.frames.without_heights()
    yield from copy_rows(frames, placed.truth, placed.is_reported, interpolated=placed.matched.interpolated > 0)
    yield judged_of_truth(frames, [(each.starts, each.ends) for each in selected])


def step_sums(placed: PlacedFrames, selected: Collection[SubTrajectories]) -> dict[int, StepSums]:
    """Return the sums of steps up to each estimate at which a sub-trajectory starts or ends, by estimate.

    The result is empty if the estimates have no covariances of steps.
    """
    estimates = placed.estimates
    if estimates.steps is None or estimates.covariance is None:
        return {}
    compared = np.unique(np.concatenate([frames for each in selected for frames in (each.starts, each.ends)]))
    return sums_of_steps(estimates, estimates.steps, placed.frames.estimate_rows[compared])


# ---- records


def association_record(placed: PlacedFrames, spacing: int, images: int | None) -> Association:
    """Return how the estimates were associated with the truth; `images` is None if they are unknown."""
    stamps_ns = placed.frames.stamps_ns
    has_frames = len(stamps_ns) > 0
    estimates_ns = placed.estimates.trajectory.stamps_ns
    return Association(
        **placed.matched._asdict(),
        **placed.states._asdict(),
        matched=len(stamps_ns),
        estimate_poses=len(estimates_ns),
        truth_poses=len(placed.truth.stamps_ns),
        estimate_unordered=unordered(estimates_ns),
        truth_unordered=unordered(placed.truth.stamps_ns),
        images=images,
        spacing_frames=spacing,
        reading=placed.reading,
        path_length_m=float(placed.length_m[-1]) if has_frames else 0.0,
        duration_s=int(stamps_ns[-1] - stamps_ns[0]) / NS_PER_S if has_frames else None,
    )


def truth_record(placed: PlacedFrames) -> TruthRecord:
    """Return the properties of the ground truth."""
    truth = placed.truth
    placement = placed.placement
    steps_m = np.linalg.norm(np.diff(placed.frames.true_position, axis=0), axis=1)
    step_m = float(np.median(steps_m)) if len(steps_m) else 0.0
    return TruthRecord(
        attitude=truth.has_attitude,
        height=truth.has_height,
        tilt=truth.has_tilt,
        sigma_m=truth.sigma_m or None,
        sigma_deg=truth.sigma_deg or None,
        path_excess=2.0 * (truth.sigma_m / step_m) ** 2 if truth.sigma_m and step_m else None,
        lever_arm_m=truth.lever_arm_m if any(truth.lever_arm_m) else (),
        declared=truth.declared,
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
    displacement. The columns are empty if no estimate has a ground truth. MetricsError if there is no condition, if
    the truth lacks the attitudes that a condition requires, or if the estimate has no attitudes.
    """
    conditions = parsed_conditions(config)
    placed = placed_frames(estimates, truth, conditions, config, image_stamps_ns)
    parts = [
        table_part(condition.setting, reading, placed.sub_trajectories(chosen.starts, chosen.ends, reading), placed)
        for condition, chosen in selected_sub_trajectories(conditions, placed, config.spacing).items()
        for reading in placed.readings
    ]
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def table_part(
    condition: str, reading: Reading, sub_trajectories: SubTrajectories, placed: PlacedFrames
) -> dict[str, NDArray[Any]]:
    """Return the sub-trajectories of one condition and their errors by one reading, as columns."""
    starts, ends, _, errors = sub_trajectories
    stamps_ns = placed.frames.stamps_ns
    true_move = sub_trajectories.true_displacement()
    columns: dict[str, NDArray[Any]] = {
        "condition": np.full(len(starts), condition, object),
        "reading": np.full(len(starts), str(reading), object),
        "start_frame": starts,
        "end_frame": ends,
        "start_stamp_ns": stamps_ns[starts],
        "end_stamp_ns": stamps_ns[ends],
        "travelled_m": np.asarray(placed.length_m[ends] - placed.length_m[starts], np.float64),
    }
    vectors = {
        "true_displacement": true_move,
        "estimated_displacement": true_move + errors.position_m,
        "error": errors.position_m,
    }
    for name, values in vectors.items():
        columns |= {f"{name}_{axis}_m": column for axis, column in zip("xyz", values.T, strict=True)}
    columns["attitude_error_deg"] = errors.attitude_deg
    columns["heading_error_deg"] = errors.heading_deg
    return columns
