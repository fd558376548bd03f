"""The figures of one condition, from frames that come in any portions."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.metrics.association import Frames
from sfr_loc_map.metrics.condition import Condition, ConditionKind
from sfr_loc_map.metrics.confidence import BlockSums, interval95
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.consistency import Consistency
from sfr_loc_map.metrics.statistics import Decimated, Moments, RowQueue, norm
from sfr_loc_map.metrics.sub_trajectories import find_ends
from sfr_loc_map.metrics.trajectory_error import COLUMNS, sub_trajectory_errors

MAX_WAITING_STARTS = 1_000_000
"""A start that has waited for its end through so many others is given up."""
MAX_WAITING_BRIEF = 5000
"""The same where a condition is brief."""
DETAIL_ROWS = 1000
"""Sub-trajectories of each condition that are kept for figures."""
FIGURES = {"position_m": slice(0, 3), "attitude_deg": slice(3, 4), "heading_deg": slice(4, 5)}
"""Figures of the score and the columns of the errors that they are made of."""
INTERVAL_COLUMNS = 5


class ConditionScore:
    """Everything about one condition."""

    def __init__(self, condition: Condition, *, brief: bool = False) -> None:
        """Start without a frame.

        Args:
            condition: What ends a sub-trajectory.
            brief: Whether only `brief` is asked of it: no interval, no consistency, no details.
        """
        self._brief = brief
        self.condition = condition
        self.moments = Moments(len(COLUMNS))
        self._grains = BlockSums(INTERVAL_COLUMNS)
        self._consistency = Consistency()
        self._overlaps = 0
        self.kept_errors = Decimated(len(COLUMNS), DETAIL_ROWS)
        self.kept_places = Decimated(4, DETAIL_ROWS, np.int64)
        self.given_up = 0
        self._kind = list(ConditionKind).index(condition.kind)
        self._value = condition.threshold
        self._most_starts = MAX_WAITING_BRIEF if brief else MAX_WAITING_STARTS
        self._starts = RowQueue()

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
            **({} if frames.covariance is None or self._brief else {"covariance": frames.covariance[new]}),
        )
        ends = find_ends(
            starts["length"],
            starts["stamp"],
            starts["frame"],
            lengths,
            frames.stamps_ns,
            first_frame,
            self._kind,
            self._value,
        )
        ends = ends[: np.searchsorted(ends, len(frames))]
        # what is given up depends on frames alone, not on the portions that they come in
        most_frames, last = self._most_starts * config.spacing, first_frame + len(frames) - 1
        rows = np.flatnonzero(first_frame + ends - starts["frame"][: len(ends)] <= most_frames)
        if len(rows):
            self._score(frames, lengths, first_frame, rows, ends[rows], config)
        self.given_up += len(ends) - len(rows)
        starts.drop(len(ends))
        too_old = int(np.searchsorted(starts["frame"], last - most_frames, side="right"))
        starts.drop(too_old)
        self.given_up += too_old

    def _score(
        self,
        frames: Frames,
        lengths: FloatArray,
        first_frame: int,
        rows: NDArray[np.intp],
        ends: IntArray,
        config: TrajectoryScoreConfig,
    ) -> None:
        starts, spacing = self._starts, config.spacing
        errors = sub_trajectory_errors(
            starts["gt_pos"],
            starts["gt_quat"],
            starts["est_pos"],
            starts["est_quat"],
            starts["length"],
            rows,
            frames.gt_pos,
            frames.gt_quat,
            frames.est_pos,
            frames.est_quat,
            lengths,
            ends,
            config.rebase == "pose",
        )
        self.moments.push(errors)
        if self._brief:
            return
        self._grains.push(errors[:, :INTERVAL_COLUMNS])
        self._overlaps += int(np.sum(-(-(first_frame + ends - starts["frame"][rows]) // spacing)))
        self.kept_errors.push(errors)
        self._check_covariance(frames, first_frame, rows, ends)
        places = (starts["frame"][rows], first_frame + ends, starts["stamp"][rows], frames.stamps_ns[ends])
        self.kept_places.push(np.column_stack(places))

    def _check_covariance(self, frames: Frames, first_frame: int, rows: NDArray[np.intp], ends: IntArray) -> None:
        if frames.covariance is None:
            return
        starts, names = self._starts, ("gt_pos", "gt_quat", "est_pos", "est_quat", "covariance")
        columns = [starts[name] for name in names]
        last = (frames.gt_pos, frames.gt_quat, frames.est_pos, frames.est_quat, frames.covariance)
        numbers = starts["frame"]
        for row, end in zip(rows.tolist(), ends.tolist(), strict=True):
            first = int(numbers[row])
            if first >= self._consistency.free_from:
                span = (first, first_frame + end)
                self._consistency.push(span, tuple(c[row] for c in columns), tuple(a[end] for a in last))

    def result(self, config: TrajectoryScoreConfig) -> dict[str, Any]:
        """Return the part of the score that belongs to the condition."""
        head = {
            "count": self.moments.count,
            "condition": self.condition.to_plain(),
            "spacing_frames": config.spacing,
            "rebase": config.rebase,
        }
        return head | self._figures()

    def brief(self) -> dict[str, Any]:
        """Return only the distance, the number of sub-trajectories and the figures."""
        plain = {name: _figure(self.moments, columns) for name, columns in FIGURES.items()}
        return {**self.condition.to_plain(), "count": self.moments.count, **plain}

    def _figures(self) -> dict[str, Any]:
        result: dict[str, Any] = dict(figures(self.moments))
        overlap = self._overlaps / max(self.moments.count, 1)
        for name, columns in FIGURES.items():
            result[name]["mean_plus_3sigma_ci95"] = interval95(
                self._grains, columns, overlap, unsigned=name == "attitude_deg"
            )
        result["overlap"] = overlap
        result["nees"] = self._consistency.result()
        result["components"] = components(self.moments)
        return result

    def details(self) -> dict[str, Any]:
        """Return the sub-trajectories, or every n-th of them, column by column."""
        places, errors = self.kept_places.rows, self.kept_errors.rows
        names = ("start_frame", "end_frame", "start_stamp_ns", "end_stamp_ns")
        columns = {name: places[:, k].tolist() for k, name in enumerate(names)}
        for k, name in enumerate(COLUMNS):
            columns[f"{name}_{_UNITS.get(name, 'm')}"] = rounded(errors[:, k])
        return {"condition": self.condition.to_plain(), "every": self.kept_places.step, **columns}


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
