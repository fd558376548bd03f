"""Stereo pairing by stamp."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Generic, TypeVar

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class _Waiting(Generic[T]):
    """An item without its partner.

    Attributes:
        stamp_ns: Its stamp.
        run: Run of its stream that it belongs to.
        item: The item.
    """

    stamp_ns: int
    run: int
    item: T


class StampPairing(Generic[T]):
    """Pairs the items of two streams by their stamps, with a bounded memory.

    Each stream comes in the order of its stamps, as one publisher's messages do, until a new run begins at an earlier
    stamp. So an item is dropped, and counted, when the other stream has come to a later stamp of the same run: its
    partner was lost, or there never was one.

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
        self._waiting: tuple[deque[_Waiting[T]], deque[_Waiting[T]]] = (deque(), deque())
        self._latest_ns: list[int | None] = [None, None]
        self._runs = [0, 0]
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
        self._latest_ns, self._runs = [None, None], [0, 0]

    def _add(self, side: int, stamp_ns: int, item: T) -> tuple[T, T] | None:
        latest = self._latest_ns[side]
        self._runs[side] += latest is not None and stamp_ns < latest
        self._latest_ns[side] = stamp_ns
        own, other = self._waiting[side], self._waiting[1 - side]
        best = min(range(len(other)), key=lambda i: abs(other[i].stamp_ns - stamp_ns), default=None)
        if best is None or abs(other[best].stamp_ns - stamp_ns) > self._tolerance_ns:
            own.append(_Waiting(stamp_ns, self._runs[side], item))
            if len(own) > self._depth:
                own.popleft()
                self.overflowed += 1
            self._drop_hopeless()
            return None
        partner = other[best].item
        self._runs[side] = other[best].run  # the same moment, so the same run
        while own and own[0].stamp_ns < stamp_ns:
            own.popleft()
            self.unpaired += 1
        for _ in range(best):
            other.popleft()
        self.unpaired += best
        other.popleft()
        return (item, partner) if side == 0 else (partner, item)

    def _drop_hopeless(self) -> None:
        """Drop what the other stream has gone past."""
        for side, queue in enumerate(self._waiting):
            latest, run = self._latest_ns[1 - side], self._runs[1 - side]
            if latest is None:
                continue
            while queue and queue[0].run == run and queue[0].stamp_ns < latest - self._tolerance_ns:
                queue.popleft()
                self.unpaired += 1
