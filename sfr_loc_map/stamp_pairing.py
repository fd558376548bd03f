"""Association of the items of two streams by their stamps: left and right images, poses, ground truth."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Sequence
from itertools import pairwise
from statistics import median_low
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

T = TypeVar("T")
STAMP_TOLERANCE_S = 0.01
"""Default of the largest stamp difference of a pair, s. The tolerance is also kept below half a period."""
MAX_TOLERANCE_S = 0.5  #: Largest accepted tolerance of stamps, s.
PERIODS = 15  #: Maximum number of gaps between the last stamps of a stream, whose median is the period of the stream.
WAITING = 1000  #: Queue depth of each stream if all stamps are known in advance.


def below_half_period(tolerance_ns: int, *gaps_ns: Collection[int]) -> int:
    """Return the tolerance, limited to less than half of the shorter period; `gaps_ns` has the gaps of each stream."""
    periods = [median_low(gaps) for gaps in gaps_ns if gaps]
    if not periods:
        return tolerance_ns
    return min(tolerance_ns, max(min(periods) - 1, 0) // 2)


def match_stamps(left: Sequence[int], right: Sequence[int], tolerance_ns: int) -> dict[int, int]:
    """Return the right stamp of each left stamp that has a partner, ns; the stamps of both streams must increase."""
    gaps = [[after - before for before, after in pairwise(stamps) if after > before] for stamps in (left, right)]
    pairing: StampPairing[int] = StampPairing(below_half_period(tolerance_ns, *gaps), WAITING)
    order = sorted([(stamp, 0) for stamp in left] + [(stamp, 1) for stamp in right])
    found = [(pairing.add_right if side else pairing.add_left)(stamp, stamp) for stamp, side in order]
    return dict(pair for pair in found if pair is not None)


def nearest_stamps(stamps: NDArray[np.int64], among: NDArray[np.int64]) -> tuple[NDArray[np.intp], NDArray[np.int64]]:
    """Return for each stamp `(N,)` the index of the nearest stamp in `among`, and the absolute difference, ns.

    `among` is sorted and not empty. Of two equally near stamps the earlier is used.
    """
    after = np.minimum(np.searchsorted(among, stamps), len(among) - 1)
    before = np.maximum(after - 1, 0)
    to_before, to_after = np.abs(stamps - among[before]), np.abs(among[after] - stamps)
    return np.where(to_before <= to_after, before, after), np.minimum(to_before, to_after)


class StampGaps:
    """The last stamp of a stream, and the last gaps between its increasing stamps, ns."""

    def __init__(self) -> None:
        """Start without stamps."""
        self.latest_ns: int | None = None
        self.recent_ns: deque[int] = deque(maxlen=PERIODS)

    def add(self, stamp_ns: int) -> None:
        """Add a stamp."""
        if self.latest_ns is not None and stamp_ns > self.latest_ns:
            self.recent_ns.append(stamp_ns - self.latest_ns)
        self.latest_ns = stamp_ns


class StampPairing(Generic[T]):
    """Pairs the items of two streams by their stamps, with bounded memory.

    The stamps of each stream increase until the stream returns to an earlier stamp. An item is therefore dropped, and
    counted as `unpaired`, when the other stream has passed its stamp by more than the tolerance and both streams have
    gone back to an earlier stamp the same number of times. `run_order`, which receives the pairs, decides whether a
    return to an earlier stamp begins a new run. `overflowed` counts items that were dropped because their queue was
    full. The tolerance is less than half of the shorter period, so that items of neighbouring frames are not paired.
    """

    def __init__(self, tolerance_ns: int, depth: int) -> None:
        """Create empty queues of at most `depth` items a side; stamps of a pair differ by at most the tolerance."""
        self._tolerance_ns = tolerance_ns
        self._depth = depth
        self._waiting: tuple[deque[tuple[int, int, T]], ...] = (deque(), deque())  # stamp, number of returns, item
        self._gaps = (StampGaps(), StampGaps())
        self._returns = [0, 0]  # how often each stream has returned to an earlier stamp
        self.unpaired = 0
        self.overflowed = 0

    def add_left(self, stamp_ns: int, item: T) -> tuple[T, T] | None:
        """Add an item of the left stream; return `(left, right)` if it completes a pair."""
        partner = self._partner_of(0, stamp_ns, item)
        return None if partner is None else (item, partner)

    def add_right(self, stamp_ns: int, item: T) -> tuple[T, T] | None:
        """Add an item of the right stream; return `(left, right)` if it completes a pair."""
        partner = self._partner_of(1, stamp_ns, item)
        return None if partner is None else (partner, item)

    def clear(self) -> None:
        """Remove the waiting items without counting them as dropped."""
        for queue in self._waiting:
            queue.clear()
        for gaps in self._gaps:
            gaps.latest_ns = None
        self._returns = [0, 0]

    def _partner_of(self, side: int, stamp_ns: int, item: T) -> T | None:
        """Return the partner of a new item, side 0 for left and 1 for right; None if the item has to wait."""
        latest = self._gaps[side].latest_ns
        self._returns[side] += latest is not None and stamp_ns < latest
        self._gaps[side].add(stamp_ns)
        own = self._waiting[side]
        other = self._waiting[1 - side]
        best = min(range(len(other)), key=lambda i: abs(other[i][0] - stamp_ns), default=None)
        if best is None or abs(other[best][0] - stamp_ns) > self._largest_difference_ns():
            own.append((stamp_ns, self._returns[side], item))
            if len(own) > self._depth:
                own.popleft()
                self.overflowed += 1
            self._drop_hopeless()
            return None
        _, self._returns[side], partner = other[best]  # the partner is of the same run
        while own and own[0][0] < stamp_ns:
            own.popleft()
            self.unpaired += 1
        for _ in range(best + 1):
            other.popleft()
        self.unpaired += best
        return partner

    def _largest_difference_ns(self) -> int:
        """Return the tolerance, limited to less than half of the shorter period."""
        return below_half_period(self._tolerance_ns, *(gaps.recent_ns for gaps in self._gaps))

    def _drop_hopeless(self) -> None:
        """Drop items whose partner can no longer arrive, because the other stream has passed their stamp."""
        for side, queue in enumerate(self._waiting):
            latest = self._gaps[1 - side].latest_ns
            returns = self._returns[1 - side]
            if latest is None:
                continue
            while queue and queue[0][1] == returns and queue[0][0] < latest - self._tolerance_ns:
                queue.popleft()
                self.unpaired += 1
