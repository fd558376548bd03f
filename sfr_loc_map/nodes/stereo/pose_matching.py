"""The stereo pairs of the next map, matched with their poses."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Generic, TypeVar

from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.mapping.config import MAX_PAIRS
from sfr_loc_map.stamp_pairing import StampGaps, below_half_period

T = TypeVar("T")
MAX_POSES = 1000  #: Number of poses kept for later pairs: 100 s at 10 Hz. The oldest pose is dropped first.
MAX_WAITING = 2 * MAX_PAIRS  #: Maximum number of pairs that wait for their poses: the pairs of two maps.


class PoseMatching(Generic[T]):
    """Holds pairs until a pose with their stamp is received; `dropped` counts the pairs whose pose was not received.

    As in a `StampPairing`, each pose belongs to one pair, and the tolerance is less than half of the period of the
    pairs or of the poses, whichever is shorter, so that the pose of a neighbouring stamp is not used.
    """

    def __init__(self, tolerance_ns: int, timeout_s: float, on_drop: Callable[[int], None]) -> None:
        """Start empty. A pair waits until the timeout; `on_drop` is called with the stamp of each dropped pair."""
        self.dropped = 0
        self._tolerance_ns, self._timeout_s, self._on_drop = tolerance_ns, timeout_s, on_drop
        self._poses: dict[int, Transform] = {}
        self._waiting: dict[int, tuple[float, T]] = {}
        self._pose_gaps, self._pair_gaps = StampGaps(), StampGaps()

    def add_pose(self, stamp_ns: int, pose: Transform) -> list[tuple[T, Transform]]:
        """Add a pose; return the pairs that now have a pose, in the order of their arrival."""
        self._pose_gaps.add(stamp_ns)
        self._poses.pop(stamp_ns, None)  # a pose with a repeated stamp becomes the newest entry
        self._poses[stamp_ns] = pose
        if len(self._poses) > MAX_POSES:
            self._poses.pop(next(iter(self._poses)))
        return self._matched()

    def add_pair(self, stamp_ns: int, pair: T) -> list[tuple[T, Transform]]:
        """Add a pair; return the pairs that now have a pose, in the order of their arrival."""
        self._pair_gaps.add(stamp_ns)
        self._waiting[stamp_ns] = (time.monotonic(), pair)
        if len(self._waiting) > MAX_WAITING:
            self._drop(next(iter(self._waiting)))
        return self._matched()

    def drop_overdue(self) -> None:
        """Drop the pairs that have waited longer than the timeout."""
        limit = time.monotonic() - self._timeout_s
        for stamp_ns in [stamp for stamp, (since, _) in self._waiting.items() if since < limit]:
            self._drop(stamp_ns)

    def clear_pairs(self) -> None:
        """Forget the pairs without counting them. Poses are kept because they may belong to the next pairs."""
        self._waiting.clear()

    def clear(self) -> None:
        """Forget pairs and poses without counting them."""
        self.clear_pairs()
        self._poses.clear()

    def _matched(self) -> list[tuple[T, Transform]]:
        found = []
        tolerance_ns = below_half_period(self._tolerance_ns, self._pose_gaps.recent_ns, self._pair_gaps.recent_ns)
        for stamp_ns in list(self._waiting):
            nearest = min(self._poses, key=lambda stamp: abs(stamp - stamp_ns), default=None)
            if nearest is not None and abs(nearest - stamp_ns) <= tolerance_ns:
                found.append((self._waiting.pop(stamp_ns)[1], self._poses.pop(nearest)))
        return found

    def _drop(self, stamp_ns: int) -> None:
        self._waiting.pop(stamp_ns)
        self.dropped += 1
        self._on_drop(stamp_ns)
