"""Which run a stamped item belongs to, by its stamp and those received before it.

Nodes and live page decide here alone whether another run begins. An item of another time than the run
(`is_of_another_time`) is held until enough of them follow each other in the order of their stamps; then they are a new
run. `RunOrder` requires items in order, as the images of a rig; `AnyOrder` takes items in any order, as the poses that
the monitor receives. `CommonRuns` has one order for each of several sources, as estimate and ground truth, whose runs
are the same.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from bisect import bisect_left, insort
from collections.abc import Mapping
from itertools import pairwise
from typing import Generic, TypeVar

from sfr_loc_map.inputs import JUMP_BACK_NS, jumped_back

T = TypeVar("T")
LEAP_NS = 3600 * 1_000_000_000  #: A stamp that far ahead of the last one is of another clock.
AGREEING = 3  #: Stamps of another time in a row that are a new run.
REGULAR = 10  #: Unknown stamps in a row that are a new run: few shuffled sequences (1 of 3.6 million) are in order.
PACE = 4  #: Duration of such a row over that at its median step; messages may have been lost.
JOIN = 2.0  #: Mean steps of a run within which an earlier item joins it.


def is_of_another_time(last_ns: int, stamp_ns: int) -> bool:
    """Return whether a stamp is of another time than the last one of a run: a second before it, or an hour after it."""
    return jumped_back(last_ns, stamp_ns) or stamp_ns - last_ns >= LEAP_NS


class StampOrder(ABC, Generic[T]):
    """Assigns the stamped items of one source to runs."""

    @property
    @abstractmethod
    def strays(self) -> int:
        """Number of items that are dropped so far because of another time."""

    @abstractmethod
    def add(self, stamp_ns: int, item: T) -> tuple[list[T], bool]:
        """Take an item; return the items that are accepted, and whether a new run begins with them."""

    @abstractmethod
    def restart(self) -> None:
        """Forget all items: the next one begins a run."""

    @abstractmethod
    def release(self) -> list[T]:
        """Restart, and return the items that may begin a run: another source has begun one."""


class RunOrder(StampOrder[T]):
    """Assigns stamped items to runs; `late` and `strays` count those that are dropped.

    An item that is not newer than the last one is late. An item of another time, a second or more before the last one
    or an hour after it, is held. If as many such items as `agreeing` follow each other in the order of their stamps,
    they are accepted: before the last one a new run begins with them, after it the run continues. If an item of the
    present time is added first, the held items are strays. A stamp of zero is no stamp.
    """

    def __init__(self, agreeing: int = AGREEING) -> None:
        """Start before the first item."""
        self.last_ns: int | None = None
        self.late = 0
        self._strays = 0
        self._agreeing = agreeing
        self._held: list[tuple[int, T]] = []

    @property
    def strays(self) -> int:
        """Number of items that are dropped so far because of another time."""
        return self._strays

    def restart(self) -> None:
        """Forget the last stamp and what is held: the next item begins a run."""
        self.last_ns = None
        self._held.clear()

    def release(self) -> list[T]:
        """Restart, and return the items that were held: another source has begun a run."""
        items = [item for _, item in self._held]
        last_ns = self._held[-1][0] if self._held else None
        self.restart()
        self.last_ns = last_ns
        return items

    def restart_if_set_back(self, now_ns: int) -> bool:
        """Restart if a clock was set back to another time than that of the last item; return whether it was."""
        if self.last_ns is None or not jumped_back(self.last_ns, now_ns):
            return False
        self.restart()
        return True

    def add(self, stamp_ns: int, item: T) -> tuple[list[T], bool]:
        """Take an item; return the items that may be processed, in order, and whether a new run begins with them."""
        last_ns = self.last_ns
        if stamp_ns <= 0:
            self._strays += 1
            return [], False
        if last_ns is None or not is_of_another_time(last_ns, stamp_ns):
            if last_ns is not None and stamp_ns <= last_ns:
                self.late += 1
                return [], False
            self._strays += len(self._held)
            self._held.clear()
            self.last_ns = stamp_ns
            return [item], False
        if self._held and stamp_ns <= self._held[-1][0]:
            self._strays += len(self._held)
            self._held.clear()
        self._held.append((stamp_ns, item))
        if len(self._held) < self._agreeing:
            return [], False
        self.last_ns = stamp_ns
        items = [held for _, held in self._held]
        self._held.clear()
        return items, stamp_ns < last_ns


class AnyOrder(StampOrder[T]):
    """Assigns stamped items that come in any order to runs; `strays` counts those that are dropped.

    An item of the time of the run is accepted whenever it comes. An item before the first one of the run is accepted
    once no gap separates it from the run. Two kinds of items begin a new run: `AGREEING` that follow each other in the
    order of their stamps and have stamps that were received before, as of a recording that is played again; or
    `REGULAR` that follow each other in the order of their stamps at a regular pace. The new run has all of them. An
    item of a known stamp, of zero, or an hour ahead is dropped otherwise.
    """

    def __init__(self) -> None:
        """Start before the first item."""
        self._dropped = 0
        self._begin([])

    def restart(self) -> None:
        """Forget all items: the next one begins a run."""
        self._break_chain()
        self._dropped += len(self._early)
        self._begin([])

    def _begin(self, stamps_ns: list[int]) -> None:
        self._seen = stamps_ns  # stamps of the run, sorted
        self._early: list[tuple[int, T]] = []  # items before the run, sorted by stamp
        self._chain: list[tuple[int, T, bool]] = []  # the last items that may begin a run, and whether each is dropped

    def release(self) -> list[T]:
        """Restart, and return the items that may begin a run: another source has begun one."""
        items = [item for _, item, _ in self._chain]
        self._take_chain()
        self._begin([])
        return items

    @property
    def strays(self) -> int:
        """Number of items that are dropped so far."""
        return self._dropped + sum(is_dropped for _, _, is_dropped in self._chain) + len(self._early)

    def add(self, stamp_ns: int, item: T) -> tuple[list[T], bool]:
        """Take an item; return the items that are accepted, and whether a new run begins with them."""
        if stamp_ns <= 0:
            self._dropped += 1
            return [], False
        last_ns = self._seen[-1] if self._seen else None
        if last_ns is None or not is_of_another_time(last_ns, stamp_ns):
            self._break_chain()
            insort(self._seen, stamp_ns)
            return [item, *self._joined()], False
        if self._chain and stamp_ns <= self._chain[-1][0]:
            self._break_chain()
        place = bisect_left(self._seen, stamp_ns)
        is_known = place < len(self._seen) and self._seen[place] == stamp_ns
        is_early = place == 0 and not is_known
        is_ahead = stamp_ns > last_ns
        self._chain.append((stamp_ns, item, is_known or is_ahead))
        if self._begins_run():
            found = self._take_chain()
            return found, not is_ahead
        if is_early:
            insort(self._early, (stamp_ns, item), key=lambda entry: entry[0])
            return self._joined(), False
        if is_known or is_ahead:
            return [], False
        insort(self._seen, stamp_ns)
        return [item, *self._joined()], False

    def _take_chain(self) -> list[T]:
        """Begin a run with the items of the chain, and return them."""
        stamps = [stamp_ns for stamp_ns, _, _ in self._chain]
        items = [item for _, item, _ in self._chain]
        self._dropped += sum(stamp_ns not in stamps for stamp_ns, _ in self._early)
        self._begin(stamps)
        return items

    def _begins_run(self) -> bool:
        """Return whether the items of the chain agree on a run of their own."""
        if len(self._chain) < AGREEING:
            return False
        if all(is_dropped for _, _, is_dropped in self._chain):
            return True
        stamps = [stamp_ns for stamp_ns, _, _ in self._chain]
        steps = sorted(after - before for before, after in pairwise(stamps))
        return len(stamps) >= REGULAR and stamps[-1] - stamps[0] <= PACE * len(stamps) * steps[len(steps) // 2]

    def _break_chain(self) -> None:
        self._dropped += sum(is_dropped for _, _, is_dropped in self._chain)
        self._chain.clear()

    def _joined(self) -> list[T]:
        """Return, and accept, the early items that no gap separates from the run."""
        found: list[T] = []
        while self._early and len(self._seen) > 1:
            stamp_ns, item = self._early[-1]
            step_ns = (self._seen[-1] - self._seen[0]) / (len(self._seen) - 1)
            if self._seen[0] - stamp_ns > JOIN * step_ns:
                break
            self._early.pop()
            self._seen.insert(0, stamp_ns)
            found.append(item)
        return found


class CommonRuns(Generic[T]):
    """Assigns the stamped items of several sources to runs that are the same for all of them.

    The first source that begins a new run begins it for all. Of the other sources, items that may belong to it are
    accepted, and items of the run before are dropped as long as their stamps do not follow those of the new run.
    Results, which arrive after the ground truth of their moment, would begin the run before again.
    """

    def __init__(self, orders: Mapping[str, StampOrder[tuple[str, int, T]]]) -> None:
        """Start before the first item; each source has its order."""
        self._orders = orders
        self._latest_ns: dict[str, int] = {}  # latest stamp of each source in the run
        self._ended_ns: dict[str, tuple[int, int]] = {}  # latest stamps of a source and of the run that it has to leave

    @property
    def strays(self) -> int:
        """Number of items that are dropped so far because of another time."""
        return sum(order.strays for order in self._orders.values())

    def restart(self) -> None:
        """Forget all items: the next one begins a run."""
        for order in self._orders.values():
            order.restart()
        self._latest_ns = {}
        self._ended_ns = {}

    def add(self, source: str, stamp_ns: int, item: T) -> tuple[list[T], bool]:
        """Take an item of a source; return the items that are accepted, and whether a new run begins with them."""
        if self._is_of_run_before(source, stamp_ns):
            return [], False
        accepted, begins_run = self._orders[source].add(stamp_ns, (source, stamp_ns, item))
        if begins_run:
            end_ns = max(self._latest_ns.values(), default=0)
            self._ended_ns = {name: (ns, end_ns) for name, ns in self._latest_ns.items() if name != source}
            self._latest_ns = {}
            for name, order in self._orders.items():
                if name != source:
                    accepted += order.release()
        for name, at_ns, _ in accepted:
            self._latest_ns[name] = max(self._latest_ns.get(name, at_ns), at_ns)
        return [content for _, _, content in accepted], begins_run

    def _is_of_run_before(self, source: str, stamp_ns: int) -> bool:
        """Return whether an item is of the run before, which another source has left."""
        if source not in self._ended_ns:
            return False
        own_ns, end_ns = self._ended_ns[source]
        new_ns = max(self._latest_ns.values(), default=stamp_ns)
        is_of_its_time = own_ns - JUMP_BACK_NS <= stamp_ns <= end_ns + JUMP_BACK_NS
        if is_of_its_time and stamp_ns - new_ns > JUMP_BACK_NS:
            return True
        del self._ended_ns[source]
        return False
