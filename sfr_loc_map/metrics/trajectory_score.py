"""The trajectory score: associate, select, error, summarise [4.1, 4.2.3]. The formulas are in `metrics.formulas`.

The same function scores a file and a live run.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray, Mask
from sfr_loc_map.geometry.rotation import matrix_from_rotvec, quat_from_matrix, quat_multiply
from sfr_loc_map.geometry.trajectory import Trajectory, Truth, at_point
from sfr_loc_map.inputs import NS_PER_S
from sfr_loc_map.metrics import formulas
from sfr_loc_map.metrics.aligned_error import umeyama
from sfr_loc_map.metrics.association import Estimates, Frames, associate
from sfr_loc_map.metrics.catalogue import ERRORS_BEYOND, KINDS, OTHER_FRAMES
from sfr_loc_map.metrics.completeness import completeness, share_of
from sfr_loc_map.metrics.config import (
    AssociationConfig,
    Condition,
    ConditionKind,
    Rebase,
    TrajectoryScoreConfig,
    label_of,
)
from sfr_loc_map.metrics.consistency import StepSums, nees_rows, sums_of_steps
from sfr_loc_map.metrics.copies import copy_rows, judged_of_truth
from sfr_loc_map.metrics.details import (
    NAMED_ERRORS,
    ErrorRows,
    PathRows,
    SubTrajectoryRows,
    TrajectoryDetails,
    Values,
    column,
)
from sfr_loc_map.metrics.formulas import Lengths, Poses, SubTrajectoryErrors
from sfr_loc_map.metrics.intervals import interval95
from sfr_loc_map.metrics.records import Association, TruthRecord
from sfr_loc_map.metrics.shortfall_kinds import BEYOND_MOST
from sfr_loc_map.metrics.table import Figure, figure_row
from sfr_loc_map.metrics.three_sigma import evidence_rows
from sfr_loc_map.metrics.truth_error import known_of, truth_error_rows, turn_rows

READINGS: dict[Rebase, Callable[[Poses, IntArray, IntArray], SubTrajectoryErrors]] = {
    Rebase.POSE: formulas.pose_reading,
    Rebase.DISPLACEMENT: formulas.displacement_reading,
    Rebase.POSITION: formulas.position_reading,
}
"""The readings of the document; see `Rebase`."""
MIN_TILT_DEG, TILT_GAIN = 0.1, 3.0
"""The complete rotation is fitted where it tilts z by this angle and reduces the residual by this factor."""
ROLL_GAIN = 1.1  #: A rotation about the line of the drive is fitted only if it reduces the residual by this factor.
BEYOND = 3.0
"""Multiple of the largest judged error from which the error up to another frame is not as the judged ones are."""
NAMED_FRAMES = 5  #: Ranges of frames that a message names.
PATH_ROWS, DETAIL_ROWS = 2000, 1000  #: Frames, and sub-trajectories of each condition, that are kept for plots.
POSITION_VARIANCES = [0, 6, 11]
"""Columns of the upper triangle of a 6 x 6 covariance that hold the variances of x, y and z."""
DISTANCES_M = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0)
"""Distances of the error against distance travelled."""
DISTANCES_SPACING, DISTANCES_BASE_M = 10, 50.0
"""Their starts are at least this many frames apart, whatever the spacing of the conditions; beyond the base in
proportion to the distance: overlapping sub-trajectories add little information."""
DISTANCES_MAX_STARTS = 5000  #: A sub-trajectory over more starts is ignored, because the rover was stationary.


class Pieces(NamedTuple):
    """The sub-trajectories of one condition, and their errors by one reading of the document."""

    starts: IntArray  #: Frames N.
    ends: IntArray  #: Frames N+x.
    poses: Poses  #: Of all frames.
    errors: SubTrajectoryErrors

    def every(self, step: int) -> Pieces:
        """Return one sub-trajectory per `step` sub-trajectories."""
        errors = SubTrajectoryErrors(*(values[::step] for values in self.errors))
        return self._replace(starts=self.starts[::step], ends=self.ends[::step], errors=errors)

    def true_displacement(self) -> FloatArray:
        """Return the true displacements from N to N+x."""
        return formulas.displacement(self.poses.true_position, self.starts, self.ends)

    def by_direction(self) -> dict[str, FloatArray]:
        """Return the position errors along x, y and z of DS, along and across the true displacement, and upright."""
        x, y, z = self.errors.position_m.T
        true_heading = formulas.heading(self.poses.true_attitude[self.ends])
        along, cross = formulas.along_and_cross(self.errors.position_m, self.true_displacement(), true_heading)
        return {"x": x, "y": y, "z": z, "along": along, "cross": cross, "vertical": z}


class ErrorFigure(NamedTuple):
    """A figure of sub-trajectories: its name in the catalogue, and its errors."""

    name: str
    errors_of: Callable[[Pieces], FloatArray]


ERRORS = [
    ErrorFigure("position", lambda pieces: pieces.errors.position_m),
    ErrorFigure("attitude", lambda pieces: pieces.errors.attitude_deg),
    ErrorFigure("heading", lambda pieces: pieces.errors.heading_deg),
]
"""Errors that depend on the reading of the document."""
ERRORS_OF_ALL_READINGS = [
    ErrorFigure("chord", lambda pieces: formulas.chord_error(pieces.poses, pieces.starts, pieces.ends))
]
"""Errors that are the same by each reading."""
HORIZONTAL = ErrorFigure("horizontal", lambda pieces: pieces.errors.position_m[:, :2])
"""Errors that a truth without heights has in place of the position errors."""


def kinds_of_errors(*, has_height: bool = False) -> tuple[ErrorFigure, ...]:
    """Return the figures of sub-trajectories; horizontal errors are a figure only of a truth without heights."""
    return (*ERRORS, *ERRORS_OF_ALL_READINGS) if has_height else (*ERRORS, *ERRORS_OF_ALL_READINGS, HORIZONTAL)


class ScoredTrajectory(NamedTuple):
    """What the trajectory adds to the score."""

    figures: tuple[Figure, ...]
    association: Association
    truth: TruthRecord
    details: TrajectoryDetails  #: What plots are drawn from; the frames only if they are wanted.
    errors: tuple[ErrorRows, ...] = ()  #: What tolerance bounds are made of, as far as that is wanted.
    unjudged: tuple[str, ...] = ()  #: Which frames are in no judged error and far beyond the judged ones.


def score_trajectory(
    estimates: Estimates,
    truth: Trajectory,
    config: TrajectoryScoreConfig,
    *,
    image_stamps_ns: IntArray | None = None,
    details: bool = True,
    under_way: bool = False,
    in_flight_ns: int = 0,
    kept_errors: Collection[tuple[str, str]] = (),
) -> ScoredTrajectory:
    """Return the score of a trajectory; poses of RB in DS, in any order.

    Images, where their stamps are known, are what an estimate has to cover, otherwise true poses; those of the last
    `in_flight_ns` may still come. `kept_errors` are the figures and conditions whose errors are all kept, because
    limits are on them. With `details` the frames are kept for plots, too. MetricsError if a
    condition is not valid, or no estimate has a ground truth (which is no error while a run is under way).
    """
    conditions = parsed_conditions(config)
    placed = placed_frames(estimates, truth, conditions, config)
    if not placed.association.matched and not under_way:
        raise MetricsError(nothing_matched(estimates.trajectory, truth))
    frames = placed.frames
    association, covered = completeness(
        estimates.trajectory, truth, placed.association, frames.stamps_ns, conditions, image_stamps_ns, in_flight_ns
    )
    unknown = placed.estimates.unknown_states(frames.est_rows)
    covered = [msgspec.structs.replace(row, value=None) if row.figure in unknown else row for row in covered]
    is_reported = (placed.estimates.lost | placed.estimates.degraded)[frames.est_rows]
    covered += copy_rows(frames, truth, is_reported, interpolated=association.interpolated > 0)
    chosen = [select(condition, config.spacing, frames, placed.length_m) for condition in conditions]
    covered.append(judged_of_truth(frames, chosen))
    sums = step_sums(placed.estimates, frames, chosen)
    figures: list[Figure] = []
    rows: list[SubTrajectoryRows] = []
    errors: list[ErrorRows] = []
    unjudged: list[str] = []
    for condition, (starts, ends) in zip(conditions, chosen, strict=True):
        pieces = Pieces(starts, ends, placed.poses, placed.reading(placed.poses, starts, ends))
        overlap = overlap_of(starts, ends, config.spacing)
        figures += error_rows(condition.setting, pieces, overlap, placed, truth)
        figures += evidence_of(condition.setting, pieces, overlap, placed, truth, sums)
        of_other_frames = list(
            rows_of_other_frames(condition.setting, pieces, placed, has_height=known_of(truth).has_height)
        )
        figures += of_other_frames
        unjudged += unjudged_frames(condition.setting, pieces, placed, of_other_frames)
        errors += error_columns(condition.setting, pieces, kept_errors)
        rows.append(sub_trajectory_rows(condition.setting, pieces, frames.stamps_ns, placed.length_m))
    figures += worst_beyond(figures)
    figures += growth_rows(placed.poses, placed.length_m, config.spacing, placed.reading)
    figures += truth_error_rows(truth, frames.stamps_ns if association.interpolated else frames.stamps_ns[:0])
    path = path_rows(placed.estimates, frames, placed.length_m) if details else None
    return ScoredTrajectory(
        figures=(*figures, *covered),
        association=association,
        truth=truth_record(truth, frames, placed.placement),
        details=TrajectoryDetails(path=path, sub_trajectories=tuple(rows)),
        errors=tuple(errors),
        unjudged=tuple(unjudged),
    )


# ---- associate


class Placement(NamedTuple):
    """The turn of an estimate and the translation after it, m, that take it to the truth."""

    yaw_deg: float
    tilt_deg: float | None  #: Of z; None where the turn is a yaw alone.
    translation_m: tuple[float, ...]


class PlacedFrames(NamedTuple):
    """Frames, how they came about, and the reading of the document by which they are judged."""

    frames: Frames
    association: Association
    estimates: Estimates
    reading: Callable[[Poses, IntArray, IntArray], SubTrajectoryErrors]
    placement: Placement | None
    poses: Poses  #: Of all frames, true heights NaN where they are unknown.
    length_m: Lengths  #: Length of the true path up to each frame.


def parsed_conditions(config: TrajectoryScoreConfig) -> list[Condition]:
    """Return the conditions of the settings; MetricsError without one."""
    if not config.conditions:
        raise MetricsError("no condition of a sub-trajectory given: give at least one, such as distance=5")
    return [Condition.parse(text) for text in config.conditions]


def placed_frames(
    estimates: Estimates, truth: Trajectory, conditions: Sequence[Condition], config: TrajectoryScoreConfig
) -> PlacedFrames:
    """Return the frames of an estimate and a truth; a truth without attitudes has the estimate fitted to it."""
    known = known_of(truth)
    if truth.has_attitude:
        rebase, placement = Rebase(config.rebase), None
        frames, association = associate(estimates.trajectory, truth, config.association)
        if not known.has_tilt:
            frames = with_estimated_tilt(frames)
        reading = of_known(known, READINGS[rebase])
    else:
        estimates, frames, association, placement = associate_positions(
            estimates, truth, conditions, config.association
        )
        rebase = Rebase.YAW_ALIGNED if placement.tilt_deg is None else Rebase.ROTATION_ALIGNED
        reading = formulas.position_reading
    true_position = frames.gt_pos
    if not known.has_height:
        true_position = true_position.copy()
        true_position[:, 2] = np.nan
    poses = Poses(true_position, frames.gt_quat, frames.est_pos, frames.est_quat)
    length_m = formulas.path_length_m(frames.gt_pos)
    association = msgspec.structs.replace(
        association,
        lost=int(np.count_nonzero(estimates.lost[frames.est_rows])),
        degraded=int(np.count_nonzero(estimates.degraded[frames.est_rows])),
        spacing_frames=config.spacing,
        rebase=rebase,
        path_length_m=float(length_m[-1]) if len(length_m) else 0.0,
        duration_s=int(frames.stamps_ns[-1] - frames.stamps_ns[0]) / NS_PER_S if len(length_m) else None,
    )
    return PlacedFrames(frames, association, estimates, reading, placement, poses, length_m)


Reading = Callable[[Poses, IntArray, IntArray], SubTrajectoryErrors]


def of_known(truth: Truth, reading: Reading) -> Reading:
    """Return a reading whose attitude errors are unknown (NaN) if roll and pitch of the truth are."""
    if truth.has_tilt:
        return reading

    def without_attitude(poses: Poses, starts: IntArray, ends: IntArray) -> SubTrajectoryErrors:
        errors = reading(poses, starts, ends)
        return errors._replace(attitude_deg=np.full_like(errors.attitude_deg, np.nan))

    return without_attitude


def with_estimated_tilt(frames: Frames) -> Frames:
    """Return frames whose true attitudes have the true heading, and the roll and pitch of the estimate.

    The estimate is re-based at N by the difference of the headings alone: unknown roll and pitch turn nothing.
    """
    half_turn = 0.5 * (formulas.heading(frames.gt_quat) - formulas.heading(frames.est_quat))
    zeros = np.zeros_like(half_turn)
    about_z = np.column_stack((zeros, zeros, np.sin(half_turn), np.cos(half_turn)))
    return frames._replace(gt_quat=quat_multiply(about_z, frames.est_quat))


def nothing_matched(estimate: Trajectory, truth: Trajectory) -> str:
    """Return the message about an estimate without a ground truth at its stamps."""
    spans = []
    for poses in (estimate, truth):
        stamps = poses.stamps_ns
        span = f" from {min(stamps) / NS_PER_S:.3f} s to {max(stamps) / NS_PER_S:.3f} s" if len(stamps) else ""
        spans.append(f"{len(stamps)} poses{span}")
    return (
        f"no estimate has a ground truth at its stamp: the estimate has {spans[0]}, the ground truth has {spans[1]}; "
        "give trajectories of the same drive and clock (sfr score --diagnose estimates the offset of a clock)"
    )


def associate_positions(
    estimates: Estimates, truth: Trajectory, conditions: Sequence[Condition], config: AssociationConfig
) -> tuple[Estimates, Frames, Association, Placement]:
    """Return estimates of the point whose positions a truth has, and their frames, aligned with the truth.

    Yaw and translation are fitted by least squares: what neither vision nor gravity observes (Zhang, Scaramuzza 2018,
    section IV-B). An estimate by vision alone that begins at the identity on a slope has a tilted z. Where the complete
    rotation tilts z and leaves a much smaller residual, the complete rotation is fitted. MetricsError for a condition
    that needs attitudes.
    """
    if any(part.kind is ConditionKind.TURN for condition in conditions for part in condition.parts):
        raise MetricsError("a condition turn=DEG needs attitudes of the truth, which has none: omit it")
    poses = estimates.trajectory
    if isinstance(truth, Truth) and poses.has_attitude:
        poses = at_point(poses, truth.lever_arm_m)
    frames, association = associate(poses, truth, config)
    turn, translation, tilt_deg = np.eye(3), np.zeros(3), None
    if len(frames.stamps_ns):
        middle, true_middle = frames.est_pos.mean(axis=0), frames.gt_pos.mean(axis=0)
        estimated, true = frames.est_pos - middle, frames.gt_pos - true_middle
        turn, tilt_deg = fitted_rotation(frames, estimated, true, has_height=known_of(truth).has_height)
        translation = true_middle - turn @ middle
        est_quat = quat_multiply(quat_from_matrix(turn), frames.est_quat)
        frames = frames._replace(est_pos=frames.est_pos @ turn.T + translation, est_quat=est_quat)
    known = replace(estimates, trajectory=poses, covariance=None, steps=None)  # a covariance is not of the fit
    yaw_deg = float(np.degrees(np.arctan2(turn[1, 0], turn[0, 0])))
    return known, frames, association, Placement(yaw_deg, tilt_deg, tuple(translation.tolist()))


def fitted_rotation(
    frames: Frames, estimated: FloatArray, true: FloatArray, *, has_height: bool
) -> tuple[FloatArray, float | None]:
    """Return the rotation that takes centred estimates `(F, 3)` to the truth, and the tilt of z, None for a yaw.

    Without true heights it is a yaw.
    """
    (x, y), (u, v) = estimated.T[:2], true.T[:2]
    yaw = float(np.arctan2((x * v - y * u).sum(), (x * u + y * v).sum()))
    upright = matrix_from_rotvec(np.array([0.0, 0.0, yaw]))
    if not has_height:
        return upright, None
    to, _, of = np.linalg.svd(true.T @ estimated @ upright.T)  # the least rotation that lays one line on the other
    across, cosine = np.cross(of[0], to[:, 0]), float(of[0] @ to[:, 0])
    sine = float(np.linalg.norm(across))
    found = [upright, matrix_from_rotvec(across * (np.arctan2(sine, cosine) / max(sine, 1e-12))) @ upright]
    with suppress(MetricsError):  # a straight line has no rotation about itself
        found.append(umeyama(frames.est_pos, frames.gt_pos, with_scale=False).rotation)
    left = [float(np.linalg.norm(estimated @ each.T - true)) for each in found]
    best = 1 if left[1] <= ROLL_GAIN * left[-1] else -1
    tilt_deg = float(np.degrees(np.arccos(np.clip(found[best][2, 2], -1.0, 1.0))))
    if tilt_deg >= MIN_TILT_DEG and left[0] > TILT_GAIN * left[best]:
        return found[best], tilt_deg
    return upright, None


# ---- select


def select(condition: Condition, spacing: int, frames: Frames, length_m: Lengths) -> tuple[IntArray, IntArray]:
    """Return the frames N and N+x of the sub-trajectories of a condition [4.1.1].

    N+x is the first frame at which all parts of the condition hold. A start whose condition is never met is skipped.
    """
    count = len(frames.stamps_ns)
    starts = formulas.start_frames(count, spacing)
    ends = np.minimum(starts + 1, count)
    metres = turn_deg = 0.0
    for part in condition.parts:
        if part.kind is ConditionKind.DISTANCE:
            ends = np.maximum(ends, formulas.ends_by_distance(starts, length_m, part.value))
        elif part.kind is ConditionKind.TIME:
            time_ns = round(part.value * NS_PER_S)
            ends = np.maximum(ends, formulas.ends_by_time(starts, frames.stamps_ns, time_ns))
        elif part.kind is ConditionKind.FRAMES:
            ends = np.maximum(ends, formulas.ends_by_frames(starts, int(part.value)))
        elif part.kind is ConditionKind.DISPLACEMENT:
            metres = part.value
        else:
            turn_deg = part.value
    if metres or turn_deg:
        ends = formulas.ends_apart(starts, ends, frames.gt_pos, frames.gt_quat, metres, turn_deg)
    is_met = ends < count
    return starts[is_met], ends[is_met]


def overlap_of(starts: IntArray, ends: IntArray, spacing: int) -> float:
    """Return how many starts lie within one sub-trajectory on average."""
    return int(np.sum(-(-(ends - starts) // spacing))) / max(len(starts), 1)


# ---- errors and their statistics


def error_row(kind: ErrorFigure, condition: str | None, part: str, pieces: Pieces, overlap: float = 0.0) -> Figure:
    """Return the row of a figure; with its 95 % interval if the overlap of the sub-trajectories is given."""
    errors = kind.errors_of(pieces)
    statistics = formulas.statistics(errors)
    if not overlap:
        return figure_row(kind.name, condition, part, statistics=statistics)
    low95, high95 = interval95(errors, overlap, unsigned=KINDS[kind.name].is_unsigned) or (None, None)
    independent = len(errors) / overlap
    return figure_row(
        kind.name, condition, part, statistics=statistics, independent=independent, low95=low95, high95=high95
    )


def condition_rows(condition: str, part: str, pieces: Pieces, overlap: float) -> Iterator[Figure]:
    """Yield the rows of one condition by the reading that is judged, then its position errors by direction."""
    for kind in (*ERRORS, *ERRORS_OF_ALL_READINGS):
        yield error_row(kind, condition, part, pieces, overlap)
    for direction, errors in pieces.by_direction().items():
        yield figure_row("position", condition, direction, statistics=formulas.statistics(errors))


def error_rows(
    condition: str, pieces: Pieces, overlap: float, placed: PlacedFrames, truth: Trajectory
) -> Iterator[Figure]:
    """Yield the errors of one condition: by the reading that is judged, then by the other readings of the document."""
    known, rebase = known_of(truth), placed.association.rebase
    yield from condition_rows(condition, str(rebase), pieces, overlap)
    if not known.has_height:
        yield error_row(HORIZONTAL, condition, str(rebase), pieces, overlap)
    for name, reading in READINGS.items() if truth.has_attitude else ():
        if name is not rebase:
            other = pieces._replace(errors=of_known(known, reading)(placed.poses, pieces.starts, pieces.ends))
            for kind in ERRORS:
                yield error_row(kind, condition, str(name), other)


def rows_of_other_frames(condition: str, judged: Pieces, placed: PlacedFrames, *, has_height: bool) -> Iterator[Figure]:
    """Yield the errors of the frames that are in no judged error, and the fraction far beyond the judged errors."""
    if not len(judged.starts):
        return
    others, frames = to_other_frames(judged, placed), len(placed.frames.stamps_ns)
    for kind in kinds_of_errors(has_height=has_height):
        yield error_row(kind, condition, OTHER_FRAMES, others)
        beyond = int(np.count_nonzero(beyond_the_judged(kind, others, judged)))
        yield figure_row(ERRORS_BEYOND, condition, kind.name, n=frames, value=share_of(beyond, frames))


def to_other_frames(judged: Pieces, placed: PlacedFrames) -> Pieces:
    """Return sub-trajectories to the frames at which no judged one starts or ends, from the nearest that is judged.

    An error that neighbouring frames have in common cancels between them, but not from a judged frame.
    """
    known = np.union1d(judged.starts, judged.ends)
    ends = np.setdiff1d(np.arange(len(placed.frames.stamps_ns)), known)
    after = np.minimum(np.searchsorted(known, ends), len(known) - 1)
    before = np.maximum(after - 1, 0)
    is_after_nearer = np.abs(known[after] - ends) < np.abs(ends - known[before])
    starts = np.where(is_after_nearer, known[after], known[before])
    return Pieces(starts, ends, placed.poses, placed.reading(placed.poses, starts, ends))


def beyond_the_judged(kind: ErrorFigure, others: Pieces, judged: Pieces) -> Mask:
    """Tell which sub-trajectories have an error far beyond the largest judged one; unknown errors have not."""
    largest, sizes = (np.linalg.norm(np.atleast_2d(kind.errors_of(pieces).T), axis=0) for pieces in (judged, others))
    return np.asarray(sizes > BEYOND * np.max(largest[np.isfinite(largest)], initial=0.0))


def unjudged_frames(condition: str, judged: Pieces, placed: PlacedFrames, rows: Sequence[Figure]) -> Iterator[str]:
    """Yield which frames are in no judged error and have an error far beyond the judged ones, if they are many."""
    many = {row.part for row in rows if row.figure == ERRORS_BEYOND and (row.value or 0.0) > BEYOND_MOST}
    kinds = [kind for kind in kinds_of_errors() if kind.name in many]
    if not kinds:
        return
    others = to_other_frames(judged, placed)
    found = others.ends[np.logical_or.reduce([beyond_the_judged(kind, others, judged) for kind in kinds])]
    breaks = np.flatnonzero(np.diff(found) > 1) + 1
    parts = [f"{part[0]}-{part[-1]}" if len(part) > 1 else f"{part[0]}" for part in np.split(found, breaks)]
    more = " ..." if len(parts) > NAMED_FRAMES else ""
    yield (
        f"{len(found)} of {len(placed.frames.stamps_ns)} frames are in no judged error over {label_of(condition)}, and "
        f"their errors are far beyond the judged ones: frames {', '.join(parts[:NAMED_FRAMES])}{more}, counted from 0"
    )


def worst_beyond(rows: Sequence[Figure]) -> list[Figure]:
    """Return the row of the largest fraction that is beyond the judged errors; empty without sub-trajectories."""
    shares = [row for row in rows if row.figure == ERRORS_BEYOND and row.value is not None]
    worst = max(shares, key=lambda row: row.value or 0.0, default=None)
    return [] if worst is None else [figure_row(ERRORS_BEYOND, n=worst.n, value=worst.value)]


def evidence_of(
    condition: str,
    pieces: Pieces,
    overlap: float,
    placed: PlacedFrames,
    truth: Trajectory,
    sums: Mapping[int, StepSums],
) -> Iterator[Figure]:
    """Yield what the errors of one condition rest on: the error of the truth, what they prove, the covariance."""
    known, noise = known_of(truth), noise_of(truth)
    if placed.association.rebase is Rebase.POSE:
        yield from turn_rows(condition, noise[1], pieces.true_displacement())
    if known.has_height:
        yield from evidence_rows(condition, pieces.errors.position_m, overlap)
    if known.has_height and known.has_tilt:
        yield from nees_rows(condition, placed.estimates, placed.frames, sums, pieces.starts, pieces.ends, noise)


def error_columns(condition: str, pieces: Pieces, kept_errors: Collection[tuple[str, str]]) -> Iterator[ErrorRows]:
    """Yield all errors of the figures whose errors over a condition are kept."""
    for kind in kinds_of_errors():
        if (kind.name, condition) in kept_errors:
            columns = tuple(column(values, None) for values in np.atleast_2d(kind.errors_of(pieces).T))
            yield ErrorRows(figure=kind.name, condition=condition, errors=columns)


def growth_rows(
    poses: Poses, length_m: Lengths, spacing: int, reading: Callable[[Poses, IntArray, IntArray], SubTrajectoryErrors]
) -> Iterator[Figure]:
    """Yield the rows of the error against the length of the sub-trajectory."""
    count = len(length_m)
    for metres in DISTANCES_M:
        apart = max(spacing, round(DISTANCES_SPACING * max(metres / DISTANCES_BASE_M, 1.0)))
        starts = formulas.start_frames(count, apart)
        ends = formulas.ends_by_distance(starts, length_m, metres)
        is_short = (ends < count) & (ends - starts <= DISTANCES_MAX_STARTS * apart)
        starts, ends = starts[is_short], ends[is_short]
        if len(starts):
            pieces = Pieces(starts, ends, poses, reading(poses, starts, ends))
            for kind in ERRORS:
                yield error_row(kind, None, f"{metres:g} m", pieces)


def noise_of(truth: Trajectory) -> tuple[float, float]:
    """Return the standard deviations of a truth, m and deg, 0 if it is taken as exact."""
    return (truth.sigma_m, truth.sigma_deg) if isinstance(truth, Truth) else (0.0, 0.0)


def step_sums(estimates: Estimates, frames: Frames, chosen: Sequence[tuple[IntArray, IntArray]]) -> dict[int, StepSums]:
    """Return the sums of steps up to each estimate at which a sub-trajectory starts or ends; empty without steps."""
    if estimates.steps is None or estimates.covariance is None:
        return {}
    compared = np.unique(np.concatenate([np.concatenate(pair) for pair in chosen]))
    return sums_of_steps(estimates, estimates.steps, frames.est_rows[compared])


def truth_record(truth: Trajectory, frames: Frames, placement: Placement | None) -> TruthRecord:
    """Return what is known of the ground truth."""
    known = known_of(truth)
    steps = np.linalg.norm(np.diff(frames.gt_pos, axis=0), axis=1)
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


# ---- raw values, from which each figure can be computed again


def pieces_table(estimates: Estimates, truth: Trajectory, config: TrajectoryScoreConfig) -> dict[str, NDArray[Any]]:
    """Return every sub-trajectory of each condition by each reading, as columns of one length.

    N and N+x are numbers of frames. The error vector is the estimated less the true displacement, where the estimated
    one is as the reading compares it. MetricsError as for the score.
    """
    conditions = parsed_conditions(config)
    placed = placed_frames(estimates, truth, conditions, config)
    frames = placed.frames
    judged = placed.association.rebase
    poses = placed.poses
    length_m = placed.length_m
    readings = {judged: placed.reading}
    if truth.has_attitude:
        readings |= {name: of_known(known_of(truth), reading) for name, reading in READINGS.items()}
    parts: list[dict[str, NDArray[Any]]] = []
    for condition in conditions:
        starts, ends = select(condition, config.spacing, frames, length_m)
        true_move = formulas.displacement(poses.true_position, starts, ends)
        for name, reading in readings.items():
            errors = reading(poses, starts, ends)
            part: dict[str, NDArray[Any]] = {
                "condition": np.full(len(starts), condition.setting, object),
                "reading": np.full(len(starts), str(name), object),
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


# ---- what plots are drawn from


def every_nth(count: int, most: int) -> int:
    """Return the power of two n for which every n-th row is kept, so that at most `most` rows remain."""
    return 1 << (max(-(-count // most), 1) - 1).bit_length()


def sub_trajectory_rows(condition: str, pieces: Pieces, stamps_ns: IntArray, length_m: Lengths) -> SubTrajectoryRows:
    """Return the sub-trajectories of a condition, thinned."""
    every = every_nth(len(pieces.starts), DETAIL_ROWS)
    shown = pieces.every(every)
    starts, ends = shown.starts, shown.ends
    directions = shown.by_direction()
    others = [kind for kind in kinds_of_errors() if kind.name not in NAMED_ERRORS]
    return SubTrajectoryRows(
        condition=condition,
        every=every,
        start_frame=tuple(starts.tolist()),
        end_frame=tuple(ends.tolist()),
        start_stamp_ns=tuple(stamps_ns[starts].tolist()),
        end_stamp_ns=tuple(stamps_ns[ends].tolist()),
        x_m=column(directions["x"]),
        y_m=column(directions["y"]),
        z_m=column(directions["z"]),
        attitude_deg=column(shown.errors.attitude_deg),
        heading_deg=column(shown.errors.heading_deg),
        chord_m=column(formulas.chord_error(shown.poses, starts, ends)),
        along_m=column(directions["along"]),
        cross_m=column(directions["cross"]),
        travelled_m=column(length_m[ends] - length_m[starts]),
        others={kind.name: column(kind.errors_of(shown)) for kind in others},
    )


def path_rows(estimates: Estimates, frames: Frames, length_m: Lengths) -> PathRows:
    """Return the frames of a trajectory, thinned."""
    every = every_nth(len(length_m), PATH_ROWS)
    shown = slice(None, None, every)
    sigma: dict[str, Values] = {}
    if estimates.covariance is not None:
        variances = estimates.covariance[frames.est_rows[shown]][:, POSITION_VARIANCES]
        deviations = np.sqrt(np.where(variances >= 0.0, variances, np.nan))
        if np.isfinite(deviations).any():
            sigma = {f"sigma_{axis}_m": column(values) for axis, values in zip("xyz", deviations.T, strict=True)}
    truth_x, truth_y, truth_z = (column(values) for values in frames.gt_pos[shown].T)
    estimate_x, estimate_y, estimate_z = (column(values) for values in frames.est_pos[shown].T)
    return PathRows(
        every=every,
        stamp_ns=tuple(frames.stamps_ns[shown].tolist()),
        travelled_m=column(length_m[shown]),
        truth_x_m=truth_x,
        truth_y_m=truth_y,
        truth_z_m=truth_z,
        estimate_x_m=estimate_x,
        estimate_y_m=estimate_y,
        estimate_z_m=estimate_z,
        lost=tuple(estimates.lost[frames.est_rows[shown]].tolist()),
        degraded=tuple(estimates.degraded[frames.est_rows[shown]].tolist()),
        **sigma,
    )
