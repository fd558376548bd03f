"""The trajectory score: sub-trajectories of each condition, their errors, and what is said of them [4.1, 4.2.3].

The same function scores a file and a live run; test/metrics/reference.py says it once more in a hundred lines.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import fields, replace
from typing import Any, NamedTuple

import numpy as np

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.geometry.rotation import matrix_from_rotvec, quat_from_matrix, quat_multiply
from sfr_loc_map.geometry.trajectory import Trajectory, Truth, at_point
from sfr_loc_map.inputs import NS_PER_S
from sfr_loc_map.metrics.aligned_error import umeyama
from sfr_loc_map.metrics.association import Estimates, Frames, associate
from sfr_loc_map.metrics.completeness import completeness
from sfr_loc_map.metrics.config import (
    AssociationConfig,
    AssociationMode,
    Condition,
    ConditionKind,
    Rebase,
    TrajectoryScoreConfig,
)
from sfr_loc_map.metrics.consistency import nees_score, sums_of_steps
from sfr_loc_map.metrics.score import (
    AssociationCounts,
    AssociationScore,
    ConditionScore,
    DistanceScore,
    ErrorComponents,
    IntervalStatistic,
    PathRows,
    Readings,
    ReadingScore,
    SubTrajectoryRows,
    TrajectoryDetails,
    TrajectoryScore,
    TruthRecord,
)
from sfr_loc_map.metrics.statistics import MAX_BLOCKS, add_moments, add_to_blocks, column, interval95, statistic
from sfr_loc_map.metrics.sub_trajectories import DISTANCE, KINDS, Progress, find_apart, find_ends, path_lengths
from sfr_loc_map.metrics.trajectory_error import (
    CHORD,
    COLUMNS,
    ONLY_POSITION,
    PART,
    READINGS,
    PoseRows,
    headings_rad,
    sub_trajectory_errors,
)

FIGURES = {"position_m": slice(0, 3), "attitude_deg": slice(3, 4), "heading_deg": slice(4, 5)}
"""Figures of the score and the columns of the errors that they are made of."""
MIN_TILT_DEG, TILT_GAIN = 0.1, 3.0
"""The whole rotation is fitted to positions alone where it tilts z by so much and leaves so many times less."""
ROLL_GAIN = 1.1  #: A turn about the line of the drive is fitted where it leaves so many times less: else it is noise.
APART = (ConditionKind.DISPLACEMENT, ConditionKind.TURN)  #: What may shrink again along a drive.
PATH_ROWS, DETAIL_ROWS = 2000, 1000  #: Frames, and sub-trajectories of each condition, that are kept for figures.
POSITION_VARIANCES = [0, 6, 11]
"""Columns of the upper triangle of a 6 x 6 covariance that hold the variances of x, y and z."""
DISTANCES_M = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0)
"""Distances of the error against distance travelled."""
DISTANCES_SPACING, DISTANCES_BASE_M = 10, 50.0
"""Their starts are at least this many frames apart, whatever the spacing of the conditions; beyond the base in
proportion to the distance: the more sub-trajectories overlap, the less one more says."""
DISTANCES_MAX_STARTS = 5000  #: A sub-trajectory of theirs through more starts than this is left out: the rover stood.


class ScoredTrajectory(NamedTuple):
    """What the trajectory adds to the score: its part, and what figures are drawn from if that is wanted."""

    score: TrajectoryScore
    details: TrajectoryDetails | None


def score_trajectory(
    estimates: Estimates,
    truth: Trajectory,
    config: TrajectoryScoreConfig,
    *,
    image_stamps_ns: IntArray | None = None,
    details: bool = True,
    under_way: bool = False,
) -> ScoredTrajectory:
    """Return the score of a trajectory; poses of RB in DS, in any order.

    Images, where their stamps are known, are what an estimate has to cover.

    MetricsError if a condition is not valid, or no estimate has a truth (which is no error while a run is under way).
    """
    conditions = [Condition.parse(text) for text in config.conditions]
    if not conditions:
        raise MetricsError("no condition of a sub-trajectory given: give at least one, such as distance=5")
    if truth.has_attitude:
        frames, counts, mode = associate(estimates.trajectory, truth, config.association)
        rebase, placed = Rebase(config.rebase), None
    else:
        estimates, frames, counts, mode, placed = associate_positions(estimates, truth, conditions, config.association)
        rebase = Rebase.YAW_ALIGNED if placed.tilt_deg is None else Rebase.ROTATION_ALIGNED
    stamps_ns, count, reading = frames.stamps_ns, len(frames.stamps_ns), READINGS.get(rebase, ONLY_POSITION)
    if not count and not under_way:
        spans = [
            f"{len(each)} poses"
            + (f" from {min(each) / NS_PER_S:.3f} s to {max(each) / NS_PER_S:.3f} s" if len(each) else "")
            for each in (estimates.trajectory.stamps_ns.tolist(), truth.stamps_ns.tolist())
        ]
        raise MetricsError(
            f"no estimate has a truth at its stamp: the estimate has {spans[0]}, the truth has {spans[1]}; give "
            "trajectories of the same drive and clock (sfr doctor finds a clock that is off)"
        )
    lost, degraded = estimates.lost[frames.est_rows], estimates.degraded[frames.est_rows]
    counts = replace(counts, lost=int(np.count_nonzero(lost)), degraded=int(np.count_nonzero(degraded)))
    tolerance_s, scores, rows = config.association.tolerance_s, [], []
    covered = completeness(
        estimates.trajectory, truth, counts, count, conditions, image_stamps_ns, round(tolerance_s * NS_PER_S)
    )
    lengths = path_lengths(frames.gt_pos)
    sigmas = (truth.sigma_m, truth.sigma_deg) if isinstance(truth, Truth) else (0.0, 0.0)
    headings = headings_rad(frames.gt_quat), headings_rad(frames.est_quat)
    poses = PoseRows(frames.gt_pos, frames.gt_quat, frames.est_pos, frames.est_quat, lengths, *headings)
    progress = Progress(stamps_ns, lengths)
    sums: dict[int, FloatArray] = {}
    if estimates.steps is not None and estimates.covariance is not None:
        pairs = [sub_trajectories(each, config.spacing, frames, progress) for each in conditions]
        compared = np.unique(np.concatenate([np.concatenate(pair) for pair in pairs]))
        sums = sums_of_steps(estimates, estimates.steps, frames.est_rows[compared])

    for condition in conditions:
        starts, ends = sub_trajectories(condition, config.spacing, frames, progress)
        number = len(starts)
        every = 1 << (max(-(-number // DETAIL_ROWS), 1) - 1).bit_length()
        stretches, kept = np.zeros((MAX_BLOCKS, 1 + 2 * len(COLUMNS))), [np.zeros((0, len(COLUMNS)))]
        found = {}  # moments by reading
        for other in {reading, *(READINGS.values() if placed is None else ())}:
            mean, squares = found[other] = np.zeros(len(COLUMNS)), np.zeros(len(COLUMNS))
            for begin in range(0, max(number, 1), PART):
                part = slice(begin, begin + PART)
                errors = sub_trajectory_errors(poses, starts[part], ends[part], other)
                add_moments(errors, begin, mean, squares)
                if other == reading:
                    add_to_blocks(errors, stretches)
                    kept.append(errors[-begin % every :: every].copy())
        mean, squares = found[reading]
        overlap = int(np.sum(-(-(ends - starts) // config.spacing))) / max(number, 1)
        nees = None
        if estimates.covariance is not None:
            nees = nees_score(frames, estimates.covariance, sums, starts, ends, sigmas)
        figures: dict[str, Any] = {}
        for name, which in (FIGURES | {"chord_m": slice(CHORD, CHORD + 1)}).items():
            plain = statistic(number, mean[which], squares[which])
            interval = interval95(stretches, which, overlap, unsigned=name == "attitude_deg")
            figures[name] = IntervalStatistic(**vars(plain), mean_plus_3sigma_ci95=interval)
        readings = {
            str(name): ReadingScore(
                **{key: statistic(number, *(part[which] for part in found[other])) for key, which in FIGURES.items()}
            )
            for name, other in READINGS.items()
            if placed is None
        }
        columns = {item.name: [COLUMNS.index(item.name)] for item in fields(ErrorComponents)}
        components = {name: statistic(number, mean[at], squares[at]) for name, at in columns.items()}
        score = ConditionScore(
            count=number,
            condition=condition,
            spacing_frames=config.spacing,
            rebase=rebase,
            overlap=overlap,
            nees=nees,
            components=ErrorComponents(**components),
            readings=Readings(**readings) if readings else None,
            **figures,
        )
        scores.append(score)
        if details:
            first, last = starts[::every], ends[::every]
            made = SubTrajectoryRows(
                condition=condition,
                every=every,
                start_frame=tuple(first.tolist()),
                end_frame=tuple(last.tolist()),
                start_stamp_ns=tuple(stamps_ns[first].tolist()),
                end_stamp_ns=tuple(stamps_ns[last].tolist()),
                **dict(zip(COLUMNS, map(column, np.concatenate(kept).T), strict=True)),
            )
            rows.append(made)

    by_distance = []
    for metres in DISTANCES_M:
        spacing = max(config.spacing, round(DISTANCES_SPACING * max(metres / DISTANCES_BASE_M, 1.0)))
        starts = np.arange(0, count, spacing)
        ends = find_ends(starts, progress, DISTANCE, metres)
        short = (ends < count) & (ends - starts <= DISTANCES_MAX_STARTS * spacing)
        if not (number := int(np.count_nonzero(short))):
            continue
        mean, squares = np.zeros(len(COLUMNS)), np.zeros(len(COLUMNS))
        add_moments(sub_trajectory_errors(poses, starts[short], ends[short], reading), 0, mean, squares)
        figures = {name: statistic(number, mean[which], squares[which]) for name, which in FIGURES.items()}
        by_distance.append(DistanceScore(distance_m=metres, count=number, **figures))

    score_of_all = TrajectoryScore(
        first=scores[0],
        matched=count,
        estimate_poses=counts.estimate_poses,
        lost=counts.lost,
        degraded=counts.degraded,
        path_length_m=float(lengths[-1, 0] + lengths[-1, 1]) if count else 0.0,
        duration_s=int(stamps_ns[-1] - stamps_ns[0]) / NS_PER_S if count else None,
        association=AssociationScore(
            counts=counts, mode=mode, tolerance_s=tolerance_s, max_gap_s=config.association.max_gap_s
        ),
        completeness=covered,
        truth=truth_record(truth, frames, placed) if placed or any(sigmas) else None,
        several=tuple(scores) if len(scores) > 1 else (),
        by_distance=tuple(by_distance),
    )
    if not details:
        return ScoredTrajectory(score_of_all, None)
    every = 1 << (max(-(-count // PATH_ROWS), 1) - 1).bit_length()
    table = {"truth": frames.gt_pos.T, "estimate": frames.est_pos.T}
    if estimates.covariance is not None:
        variances = estimates.covariance[frames.est_rows][:, POSITION_VARIANCES].T
        if np.isfinite(deviations := np.sqrt(np.where(variances >= 0.0, variances, np.nan)))[:, ::every].any():
            table["sigma"] = deviations
    path = PathRows(
        every=every,
        stamp_ns=tuple(stamps_ns[::every].tolist()),
        travelled_m=column(lengths[::every, 0] + lengths[::every, 1]),
        lost=tuple(lost[::every].tolist()),
        degraded=tuple(degraded[::every].tolist()),
        **{
            f"{name}_{axis}_m": column(values[::every])
            for name, axes in table.items()
            for axis, values in zip("xyz", axes, strict=True)
        },
    )
    return ScoredTrajectory(score_of_all, TrajectoryDetails(path=path, sub_trajectories=tuple(rows)))


def sub_trajectories(
    condition: Condition, spacing: int, frames: Frames, progress: Progress
) -> tuple[IntArray, IntArray]:
    """Return the frames at which the sub-trajectories of a condition start and end."""
    count = len(frames.stamps_ns)
    starts = np.arange(0, count, spacing)
    ends, apart = np.minimum(starts + 1, count), dict.fromkeys(APART, 0.0)
    for part in (condition, *condition.others):  # what only grows along a drive, then what does not
        if part.kind in apart:
            apart[part.kind] = part.value
            continue
        threshold = float(round(part.value * NS_PER_S)) if part.kind is ConditionKind.TIME else part.value
        ends = np.maximum(ends, find_ends(starts, progress, KINDS[part.kind], threshold))
    if any(apart.values()):
        metres, turn_deg = apart.values()
        ends = find_apart(starts, ends, frames.gt_pos, frames.gt_quat, metres, np.radians(turn_deg))
    return starts[ends < count], ends[ends < count]


class Placement(NamedTuple):
    """The turn of an estimate and the translation after it, m, that take it to the truth."""

    yaw_deg: float
    tilt_deg: float | None  #: Of z; None where the turn is a yaw alone.
    translation_m: tuple[float, ...]


def associate_positions(
    estimates: Estimates, truth: Trajectory, conditions: Sequence[Condition], config: AssociationConfig
) -> tuple[Estimates, Frames, AssociationCounts, AssociationMode, Placement]:
    """Return estimates of the point whose positions a truth has, and their frames, turned and moved to it.

    Yaw and translation are fitted by least squares: what neither vision nor gravity tells (Zhang, Scaramuzza 2018,
    section IV-B). An estimate by vision alone that begins at the identity on a slope has a tilted z: where the whole
    rotation tilts z and leaves much less, it is the fit. MetricsError for a condition that needs attitudes.
    """
    if any(part.kind is ConditionKind.TURN for condition in conditions for part in condition.parts):
        raise MetricsError("a condition turn=DEG needs attitudes of the truth, which has none: leave it out")
    poses = estimates.trajectory
    if isinstance(truth, Truth) and poses.has_attitude:
        poses = at_point(poses, truth.lever_arm_m)
    frames, counts, mode = associate(poses, truth, config)
    turn, translation, tilt_deg = np.eye(3), np.zeros(3), None
    if len(frames.stamps_ns):
        middle, true_middle = frames.est_pos.mean(axis=0), frames.gt_pos.mean(axis=0)
        (x, y), (u, v) = (frames.est_pos - middle).T[:2], (frames.gt_pos - true_middle).T[:2]
        yaw = float(np.arctan2((x * v - y * u).sum(), (x * u + y * v).sum()))
        turn = matrix_from_rotvec(np.array([0.0, 0.0, yaw]))
        est, true = frames.est_pos - middle, frames.gt_pos - true_middle
        to, _, of = np.linalg.svd(true.T @ est @ turn.T)  # the least rotation that lays one line on the other
        across, cosine = np.cross(of[0], to[:, 0]), float(of[0] @ to[:, 0])
        sine = float(np.linalg.norm(across))
        found = [turn, matrix_from_rotvec(across * (np.arctan2(sine, cosine) / max(sine, 1e-12))) @ turn]
        with suppress(MetricsError):  # a straight line has no rotation about itself
            found.append(umeyama(frames.est_pos, frames.gt_pos, with_scale=False).rotation)
        left = [float(np.linalg.norm(est @ each.T - true)) for each in found]
        best = 1 if left[1] <= ROLL_GAIN * left[-1] else -1
        tilted = float(np.degrees(np.arccos(np.clip(found[best][2, 2], -1.0, 1.0))))
        if tilted >= MIN_TILT_DEG and left[0] > TILT_GAIN * left[best]:
            turn, tilt_deg = found[best], tilted
        translation = true_middle - turn @ middle
        est_quat = quat_multiply(quat_from_matrix(turn), frames.est_quat)
        frames = frames._replace(est_pos=frames.est_pos @ turn.T + translation, est_quat=est_quat)
    known = Estimates(poses, estimates.lost, estimates.degraded, None)  # its covariance says nothing of the fit
    yaw_deg = float(np.degrees(np.arctan2(turn[1, 0], turn[0, 0])))
    return known, frames, counts, mode, Placement(yaw_deg, tilt_deg, tuple(translation.tolist()))


def truth_record(truth: Trajectory, frames: Frames, placed: Placement | None) -> TruthRecord:
    """Return what is known of a truth that has noise, or positions alone."""
    known = truth if isinstance(truth, Truth) else Truth(truth.stamps_ns, truth.positions, truth.quats_xyzw)
    steps = np.linalg.norm(np.diff(frames.gt_pos, axis=0), axis=1)
    step = float(np.median(steps)) if len(steps) else 0.0
    return TruthRecord(
        attitude=truth.has_attitude,
        sigma_m=known.sigma_m or None,
        sigma_deg=known.sigma_deg or None,
        path_excess=2.0 * (known.sigma_m / step) ** 2 if known.sigma_m and step else None,
        lever_arm_m=known.lever_arm_m if any(known.lever_arm_m) else (),
        **({} if placed is None else placed._asdict()),
    )
