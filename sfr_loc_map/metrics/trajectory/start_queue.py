"""Starts that wait for their end, kept once for all conditions with the same spacing."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from sfr_loc_map.metrics.statistics.running_statistics import RowQueue
from sfr_loc_map.metrics.trajectory.association import Frames
from sfr_loc_map.metrics.trajectory.sub_trajectories import Progress

Starts = dict[str, NDArray[Any]]
"""Columns of starts, by name."""


class StartQueue:
    """Frames at which sub-trajectories start, in their order; each condition reads on from where it is."""

    def __init__(self, spacing: int) -> None:
        """Start without a frame; one of `spacing` frames is a start."""
        self._rows = RowQueue()
        self._spacing = spacing
        self._dropped = 0

    def append(self, frames: Frames, progress: Progress) -> None:
        """Add the starts among frames."""
        new = slice(-int(progress.frames[0]) % self._spacing, None, self._spacing)
        self._rows.append(
            frame=progress.frames[new],
            stamp=progress.stamps_ns[new],
            length=progress.lengths[new],
            gt_pos=frames.gt_pos[new],
            gt_quat=frames.gt_quat[new],
            est_pos=frames.est_pos[new],
            est_quat=frames.est_quat[new],
            **({} if frames.covariance is None else {"covariance": frames.covariance[new]}),
            **({} if frames.sums is None else {"sums": frames.sums[new]}),
        )

    def waiting(self, passed: int) -> Starts:
        """Return the columns behind so many starts as views that hold until the next change."""
        return {name: self._rows[name][passed - self._dropped :] for name in self._rows.names}

    def drop(self, passed: int) -> None:
        """Drop the first starts, so many in all, that no condition needs any more."""
        self._rows.drop(passed - self._dropped)
        self._dropped = passed
