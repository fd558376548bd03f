"""The trajectory score: frames in, figures out; the same path for a file at once and for a live run."""

from __future__ import annotations

import copy
from dataclasses import asdict
from typing import Any

import numpy as np

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.rotation import FloatArray
from sfr_loc_map.geometry.trajectory import IntArray, Trajectory
from sfr_loc_map.metrics.association import NS, AssociationCounts, Estimates, Frames, associate
from sfr_loc_map.metrics.confidence import Grains, interval95
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.statistics import Moments, RowQueue, Thinned, norm
from sfr_loc_map.metrics.sub_trajectories import KINDS, Condition, find_ends, path_lengths
from sfr_loc_map.metrics.trajectory_error import COLUMNS, sub_trajectory_errors

MAX_WAITING_STARTS = 1_000_000
"""Starts that wait for their end; beyond, the oldest are given up (they have waited through a million others)."""
DETAIL_ROWS = 1000
"""Sub-trajectories of each condition that are kept for figures."""
PATH_ROWS = 2000
"""Frames that are kept for figures."""
CHUNK_FRAMES = 65536
FIGURES = {"position_m": slice(0, 3), "attitude_deg": slice(3, 4), "heading_deg": slice(4, 5)}
"""Figures of the score and the columns of the errors that they are made of."""
INTERVAL_COLUMNS = 5


class ConditionScore:
    """Everything about one condition."""

    def __init__(self, condition: Condition) -> None:
        self.condition = condition
        self.moments = Moments(len(COLUMNS))
        self._grains = Grains(INTERVAL_COLUMNS)
        self._overlaps = 0
        self.kept_errors = Thinned(len(COLUMNS), DETAIL_ROWS)
        self.kept_places = Thinned(4, DETAIL_ROWS, np.int64)
        self.given_up = 0
        self._kind = list(KINDS).index(condition.kind)
        self._value = round(condition.value * NS) if condition.kind == "time" else condition.value
        row, three, four = np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 4))
        self._starts = RowQueue(
            frame=row, stamp=row, length=np.empty((0, 2)), gt_pos=three, gt_quat=four, est_pos=three, est_quat=four
        )

    def push(self, frames: Frames, lengths: FloatArray, first_frame: int, config: TrajectoryScoreConfig) -> None:
        """Add frames with their path lengths `(N, 2)`; `first_frame` is the number of the first."""
        starts, numbers = self._starts, first_frame + np.arange(len(frames))
        new = slice(-first_frame % config.spacing, None, config.spacing)
        starts.append(
            frame=numbers[new],
            stamp=frames.stamps_ns[new],
            length=lengths[new],
            gt_pos=frames.gt_pos[new],
            gt_quat=frames.gt_quat[new],
            est_pos=frames.est_pos[new],
            est_quat=frames.est_quat[new],
        )
        ends = find_ends(
            starts["length"],
            starts["stamp"],
            starts["frame"],
            lengths,
            frames.stamps_ns,
            first_frame,
            self._kind,
            float(self._value),
        )
        ends = ends[: np.searchsorted(ends, len(frames))]
        if len(ends):
            self._score(frames, lengths, first_frame, ends, config)
            starts.drop(len(ends))
        too_many = max(len(starts) - MAX_WAITING_STARTS, 0)
        starts.drop(too_many)
        self.given_up += too_many

    def _score(
        self, frames: Frames, lengths: FloatArray, first_frame: int, ends: IntArray, config: TrajectoryScoreConfig
    ) -> None:
        starts, count, spacing = self._starts, len(ends), config.spacing
        errors = sub_trajectory_errors(
            starts["gt_pos"],
            starts["gt_quat"],
            starts["est_pos"],
            starts["est_quat"],
            starts["length"],
            np.arange(count),
            frames.gt_pos,
            frames.gt_quat,
            frames.est_pos,
            frames.est_quat,
            lengths,
            ends,
            config.rebase == "pose",
        )
        self.moments.push(errors)
        self._grains.push(errors[:, :INTERVAL_COLUMNS])
        self._overlaps += int(np.sum(-(-(first_frame + ends - starts["frame"][:count]) // spacing)))
        self.kept_errors.push(errors)
        places = (starts["frame"][:count], first_frame + ends, starts["stamp"][:count], frames.stamps_ns[ends])
        self.kept_places.push(np.column_stack(places))

    def result(self, config: TrajectoryScoreConfig) -> dict[str, Any]:
        """Return the part of the score that belongs to the condition."""
        head = {
            "count": self.moments.count,
            "condition": self.condition.as_dict(),
            "spacing_frames": config.spacing,
            "rebase": config.rebase,
        }
        return head | self._figures()

    def _figures(self) -> dict[str, Any]:
        result: dict[str, Any] = dict(figures(self.moments))
        overlap = self._overlaps / max(self.moments.count, 1)
        for name, columns in FIGURES.items():
            result[name]["mean_plus_3sigma_ci95"] = interval95(
                self._grains, columns, overlap, unsigned=name == "attitude_deg"
            )
        result["overlap"] = overlap
        result["components"] = components(self.moments)
        return result

    def details(self) -> dict[str, Any]:
        """Return the sub-trajectories, or every n-th of them, column by column."""
        places, errors = self.kept_places.rows, self.kept_errors.rows
        names = ("start_frame", "end_frame", "start_stamp_ns", "end_stamp_ns")
        columns = {name: places[:, k].tolist() for k, name in enumerate(names)}
        for k, name in enumerate(COLUMNS):
            columns[f"{name}_{_UNITS.get(name, 'm')}"] = rounded(errors[:, k])
        return {"condition": self.condition.as_dict(), "every": self.kept_places.step, **columns}


_UNITS = {"attitude": "deg", "heading": "deg"}


def rounded(values: FloatArray) -> list[float]:
    """Return numbers for figures, to 1e-9 (that is what a page needs; the score itself is not rounded)."""
    return [round(value, 9) for value in values.tolist()]


def figures(moments: Moments) -> dict[str, dict[str, Any]]:
    """Return position, attitude and heading error over all sub-trajectories [4.2.3]; None where undefined.

    The mean of position is the norm of the mean vector and its sigma the norm of the sigmas of the axes of DS; the mean
    of heading has its sign, which is left out in mean + 3 sigma.
    """
    return {name: _figure(moments, columns) | {"mean_plus_3sigma_ci95": None} for name, columns in FIGURES.items()}


def components(moments: Moments) -> dict[str, dict[str, Any]]:
    """Return the position error by axes of DS, and along and across the true way, m; means with their signs."""
    names = [name for name in COLUMNS if name in ("x", "y", "z", "along", "cross", "vertical")]
    return {f"{name}_m": _figure(moments, slice(k := COLUMNS.index(name), k + 1)) for name in names}


def _figure(moments: Moments, columns: slice) -> dict[str, Any]:
    mean = reduced(moments.mean[columns]) if moments.count else None
    sigma = None if moments.sigma is None else reduced(moments.sigma[columns])
    total = None if mean is None or sigma is None else abs(mean) + 3.0 * sigma
    return {"mean": mean, "sigma": sigma, "mean_plus_3sigma": total}


def reduced(values: FloatArray) -> float:
    """Return the norm of a vector, a single number as it is."""
    return float(values[0]) if len(values) == 1 else norm(values)


class TrajectoryScore:
    """Scores frames as they come; memory and cost per frame do not grow with the length of the run."""

    def __init__(self, config: TrajectoryScoreConfig) -> None:
        """Prepare for the conditions of the settings.

        Raises:
            MetricsError: If a condition is not valid.
        """
        self._config = config
        self._conditions = [ConditionScore(Condition.parse(text)) for text in config.conditions]
        if not self._conditions:
            raise MetricsError("no condition of a sub-trajectory given: give at least one, such as distance=5")
        self._frames = 0
        self._length = np.zeros(2)
        self._last = np.full(3, np.nan)
        self._first_stamp_ns: int | None = None
        self._last_stamp_ns: int | None = None
        self._path = Thinned(8, PATH_ROWS)
        self._path_stamps = Thinned(1, PATH_ROWS, np.int64)
        self._path_lost = Thinned(1, PATH_ROWS, np.bool_)

    def copy(self) -> TrajectoryScore:
        """Return a score that goes its own way from here."""
        return copy.deepcopy(self)

    def push(self, frames: Frames) -> None:
        """Add frames, later than all before."""
        for first in range(0, len(frames), CHUNK_FRAMES):
            self._push(frames.rows(slice(first, first + CHUNK_FRAMES)))

    def _push(self, frames: Frames) -> None:
        lengths = path_lengths(frames.gt_pos, self._last, self._length)
        for condition in self._conditions:
            condition.push(frames, lengths, self._frames, self._config)
        self._frames += len(frames)
        if self._first_stamp_ns is None:
            self._first_stamp_ns = int(frames.stamps_ns[0])
        self._last_stamp_ns = int(frames.stamps_ns[-1])
        self._path.push(np.column_stack((frames.gt_pos, frames.est_pos, lengths)))
        self._path_stamps.push(frames.stamps_ns[:, None])
        self._path_lost.push(frames.lost[:, None])

    def result(self, counts: AssociationCounts, way: str) -> dict[str, Any]:
        """Return `{"trajectory": ..., "details": {"trajectory": ...}}` of the score."""
        each = [condition.result(self._config) for condition in self._conditions]
        trajectory = {**each[0], "matched": counts.matched, "estimate_poses": counts.estimate_poses}
        trajectory |= self._facts(counts, way)
        if len(each) > 1:
            trajectory["conditions"] = each
        return {"trajectory": trajectory, "details": {"trajectory": self._details()}}

    def _facts(self, counts: AssociationCounts, way: str) -> dict[str, Any]:
        association = asdict(counts) | {
            "truth": way,
            "tolerance_s": self._config.association.tolerance_s,
            "max_gap_s": self._config.association.max_gap_s,
        }
        duration = None
        if self._first_stamp_ns is not None and self._last_stamp_ns is not None:
            duration = (self._last_stamp_ns - self._first_stamp_ns) / NS
        return {
            "lost": counts.lost,
            "path_length_m": float(self._length[0] + self._length[1]),
            "duration_s": duration,
            "starts_given_up": sum(condition.given_up for condition in self._conditions),
            "association": association,
        }

    def _details(self) -> dict[str, Any]:
        rows = self._path.rows
        path = {"every": self._path.step, "stamp_ns": self._path_stamps.rows[:, 0].tolist()}
        path |= {"travelled_m": rounded(rows[:, 6] + rows[:, 7])}
        for k, name in enumerate(("truth_x", "truth_y", "truth_z", "estimate_x", "estimate_y", "estimate_z")):
            path[name + "_m"] = rounded(rows[:, k])
        path["lost"] = self._path_lost.rows[:, 0].tolist()
        return {"path": path, "sub_trajectories": [condition.details() for condition in self._conditions]}


def score_trajectory(estimates: Estimates, truth: Trajectory, config: TrajectoryScoreConfig) -> dict[str, Any]:
    """Return `{"trajectory": ..., "details": {"trajectory": ...}}`, plain values ready for JSON.

    Args:
        estimates: Estimated poses of RB in DS, in any order.
        truth: True poses of RB in DS, in any order.
        config: Settings.

    Raises:
        MetricsError: If no estimate has a truth, or a condition is not valid.
    """
    score = TrajectoryScore(config)
    frames, counts, way = associate(estimates, truth, config.association)
    if not len(frames):
        raise MetricsError(_nothing_in_common(estimates.trajectory, truth))
    score.push(frames)
    return score.result(counts, way)


def _nothing_in_common(estimate: Trajectory, truth: Trajectory) -> str:
    spans = [
        f"{name} has {len(t)} poses"
        + (f" from {t.stamps_ns.min() / NS:.3f} s to {t.stamps_ns.max() / NS:.3f} s" if len(t) else "")
        for name, t in (("the estimate", estimate), ("the truth", truth))
    ]
    return f"no estimate has a truth at its stamp: {', '.join(spans)}; give trajectories of the same drive and clock"
