"""Stereo pairing by stamp."""

from __future__ import annotations

from collections import deque
from typing import Generic, TypeVar

T = TypeVar("T")


class StampPairing(Generic[T]):
    """Pairs the items of two streams by their stamps, with a bounded memory.

    Each stream comes in the order of its stamps, as a reliable topic does. So when two items match, what is older on
    either side has lost its partner and is dropped, and counted.

    Attributes:
        unpaired: Items dropped because their partner never came.
        overflowed: Items dropped because the queue of their side was full.
    """

    def __init__(self, tolerance_ns: int, depth: int) -> None:
        """Start empty.

        Args:
            tolerance_ns: Largest difference of the stamps of a pair, nanoseconds; 0 for equal stamps.
            depth: Most items that wait on each side.
        """
        self._tolerance_ns = tolerance_ns
        self._depth = depth
        self._waiting: tuple[deque[tuple[int, T]], deque[tuple[int, T]]] = (deque(), deque())
        self.unpaired = 0
        self.overflowed = 0

    def add_left(self, stamp_ns: int, item: T) -> tuple[T, T] | None:
        """Take an item of the left stream; return `(left, right)` if it completes a pair."""
        return self._add(0, stamp_ns, item)

    def add_right(self, stamp_ns: int, item: T) -> tuple[T, T] | None:
        """Take an item of the right stream; return `(left, right)` if it completes a pair."""
        return self._add(1, stamp_ns, item)

    def clear(self) -> None:
        """Forget what waits, without counting it as dropped."""
        for queue in self._waiting:
            queue.clear()

    def _add(self, side: int, stamp_ns: int, item: T) -> tuple[T, T] | None:
        own, other = self._waiting[side], self._waiting[1 - side]
        best = min(range(len(other)), key=lambda i: abs(other[i][0] - stamp_ns), default=None)
        if best is None or abs(other[best][0] - stamp_ns) > self._tolerance_ns:
            own.append((stamp_ns, item))
            if len(own) > self._depth:
                own.popleft()
                self.overflowed += 1
            return None
        partner = other[best][1]
        self._drop_older(own, stamp_ns)
        for _ in range(best):
            other.popleft()
        self.unpaired += best
        other.popleft()
        return (item, partner) if side == 0 else (partner, item)

    def _drop_older(self, queue: deque[tuple[int, T]], stamp_ns: int) -> None:
        while queue and queue[0][0] < stamp_ns:
            queue.popleft()
            self.unpaired += 1
