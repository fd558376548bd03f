"""Assignment of stamped items to runs, by their stamps and the stamps received earlier.

A run is one continuous sequence of stamps; a recording that is played again begins a new run. Nodes and the live page
detect new runs by this module. Where a stamp has another meaning, such as the end of a path or the time of a clock,
another rule holds (docs/nodes.md, "Time"). An item is *of another time* than the run if its stamp is 1 s or more
before, or 1 h or more after, the last stamp of the run (`is_of_another_time`). Such items begin a new run once enough
of them arrive in the order of their stamps. `RunOrder` requires items in order, such as the images of a rig. `AnyOrder`
accepts items in any order, such as the poses that monitor and live page receive. `CommonRuns` keeps the runs of several
sources in step, such as estimate and ground truth.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from array import array
from bisect import bisect_left, insort
from collections.abc import Mapping
from itertools import pairwise
from typing import Generic, TypeVar

from sfr_loc_map.message_stamps import JUMP_BACK_NS, jumped_back

T = TypeVar("T")
LEAP_NS = 3600 * 1_000_000_000
"""A stamp ahead of the last stamp by this many nanoseconds or more is taken to be from another clock."""
AGREEING = 3  #: Number of consecutive items of another time that begin a new run if their stamps increase.
REGULAR = 10
"""Number of consecutive increasing stamps at a regular pace that begin a new run even if none was received earlier.
Only 1 of 3.6 million permutations of ten stamps increases."""
PACE = 4
"""Maximum duration of `REGULAR` or more stamps at a regular pace, as a multiple of their number times their median
step. Lost messages increase the duration."""
JOIN = 2.0  #: An earlier item joins a run if it precedes the first stamp by at most this many mean steps of the run.


def is_of_another_time(last_ns: int, stamp_ns: int) -> bool:
    """Return whether a stamp is 1 s or more before the last stamp of a run, or 1 h or more after."""
    return jumped_back(last_ns, stamp_ns) or stamp_ns - last_ns >= LEAP_NS


def continues_held(held_ns: int, last_ns: int, stamp_ns: int) -> bool:
    """Return whether a stamp of another time than a run exceeds the last held stamp and is on the same side of the run.

    `last_ns` is the last stamp of the run: held stamps are all before or all after the run.
    """
    is_other_side = held_ns < last_ns < stamp_ns
    return stamp_ns > held_ns and not is_other_side


class StampOrder(ABC, Generic[T]):
    """Assigns the stamped items of a source to runs."""

    @property
    @abstractmethod
    def strays(self) -> int:
        """Number of items dropped so far because of their stamps."""

    @abstractmethod
    def add(self, stamp_ns: int, item: T) -> tuple[list[T], bool]:
        """Add an item; return the items that are accepted, and whether a new run begins with them."""

    @abstractmethod
    def restart(self) -> None:
        """Forget all items; the next item begins a run."""

    @abstractmethod
    def release(self) -> list[T]:
        """Restart, because another source has begun a run, and return the items that may belong to that run."""


class RunOrder(StampOrder[T]):
    """Assigns stamped items to runs; `late` and `strays` count the dropped items.

    An item whose stamp does not exceed the last stamp is late. An item of another time (`is_of_another_time`) is held.
    Once `agreeing` held items have increasing stamps, all before or all after the last stamp, they are accepted. Items
    before the last stamp begin a new run, and items after the last stamp continue the run. If an item of the run, or of
    another time on the opposite side of the run, arrives before that, the held items are strays. An item with a stamp
    of zero or less is also a stray.
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
        """Number of items dropped so far because of their stamps."""
        return self._strays

    def restart(self) -> None:
        """Forget the last stamp and the held items; the next item begins a run."""
        self.last_ns = None
        self._held.clear()

    def release(self) -> list[T]:
        """Restart, because another source has begun a run, and return the held items."""
        items = [item for _, item in self._held]
        last_ns = self._held[-1][0] if self._held else None
        self.restart()
        self.last_ns = last_ns
        return items

    def restart_if_set_back(self, now_ns: int) -> bool:
        """Restart if `now_ns` is 1 s or more before the last stamp; return whether the clock was set back."""
        if self.last_ns is None or not jumped_back(self.last_ns, now_ns):
            return False
        self.restart()
        return True

    def add(self, stamp_ns: int, item: T) -> tuple[list[T], bool]:
        """Add an item; return the items that are accepted, in order, and whether a new run begins with them."""
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
        if self._held and not continues_held(self._held[-1][0], last_ns, stamp_ns):
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
    """Assigns stamped items that arrive in any order to runs; `strays` counts the dropped items.

    An item after the first stamp of the run is accepted if the lead over the last stamp is below an hour. An item
    before the first stamp is accepted once no gap separates the item from the run (`JOIN`).

    Consecutive items of another time (`is_of_another_time`) are accepted together if their stamps increase, are all
    before or all after the last stamp, and one of two conditions holds. Either there are `AGREEING` items, each of
    which is an hour or more ahead or has a stamp that was received earlier, as when a recording is played again. Or
    there are `REGULAR` items at a regular pace. The accepted items begin a new run if they are before the last stamp;
    otherwise the run continues with them.

    Other items of another time are dropped if their stamp was received earlier or is an hour or more ahead. Otherwise
    the first paragraph applies to them. An item with a stamp of zero or less is also dropped.
    """

    def __init__(self) -> None:
        """Start before the first item."""
        self._dropped = 0
        self._begin([])

    def restart(self) -> None:
        """Forget all items; the next item begins a run."""
        self._break_chain()
        self._dropped += len(self._early)
        self._begin([])

    def _begin(self, stamps_ns: list[int]) -> None:
        self._seen = array("q", stamps_ns)  # stamps of the run, sorted; 8 bytes each
        self._early: list[tuple[int, T]] = []  # items from before the run, sorted by stamp
        # recent items that may begin a run, and whether each is dropped if it begins none
        self._chain: list[tuple[int, T, bool]] = []

    def release(self) -> list[T]:
        """Restart, because another source has begun a run, and return the items that may belong to that run."""
        items = [item for _, item, _ in self._chain]
        self._take_chain()
        self._begin([])
        return items

    @property
    def strays(self) -> int:
        """Number of items dropped so far, including early items that have not joined the run."""
        return self._dropped + sum(is_dropped for _, _, is_dropped in self._chain) + len(self._early)

    def add(self, stamp_ns: int, item: T) -> tuple[list[T], bool]:
        """Add an item; return the items that are accepted, and whether a new run begins with them."""
        if stamp_ns <= 0:
            self._dropped += 1
            return [], False
        last_ns = self._seen[-1] if self._seen else None
        if last_ns is None or not is_of_another_time(last_ns, stamp_ns):
            self._break_chain()
            insort(self._seen, stamp_ns)
            return [item, *self._joined()], False
        if self._chain and not continues_held(self._chain[-1][0], last_ns, stamp_ns):
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
        """Begin a run with the items of the chain, and return these items."""
        stamps = [stamp_ns for stamp_ns, _, _ in self._chain]
        items = [item for _, item, _ in self._chain]
        self._dropped += sum(stamp_ns not in stamps for stamp_ns, _ in self._early)
        self._begin(stamps)
        return items

    def _begins_run(self) -> bool:
        """Return whether the items of the chain form a new run."""
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
        """Accept and return the early items that no gap separates from the run."""
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
    """Assigns the stamped items of several sources to common runs.

    The first source that begins a new run begins it for all sources. Items that the other sources hold for a new run
    are then accepted. Late items of the previous run are dropped until their source sends a stamp that fits the new
    run. Otherwise results of the previous run, which arrive later than the ground truth of the same stamp, would
    restart that run.
    """

    def __init__(self, orders: Mapping[str, StampOrder[tuple[str, int, T]]]) -> None:
        """Start before the first item; `orders` has one order per source."""
        self._orders = orders
        self._latest_ns: dict[str, int] = {}  # latest stamp of each source in the run
        # latest stamps of the previous run, by source: of the source and of all
        self._ended_ns: dict[str, tuple[int, int]] = {}

    @property
    def strays(self) -> int:
        """Number of items dropped so far because of their stamps."""
        return sum(order.strays for order in self._orders.values())

    def restart(self) -> None:
        """Forget all items; the next item begins a run."""
        for order in self._orders.values():
            order.restart()
        self._latest_ns = {}
        self._ended_ns = {}

    def add(self, source: str, stamp_ns: int, item: T) -> tuple[list[T], bool]:
        """Add an item of a source; return the items that are accepted, and whether a new run begins with them."""
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
        """Return whether an item belongs to the previous run, which another source has ended."""
        if source not in self._ended_ns:
            return False
        own_ns, end_ns = self._ended_ns[source]
        new_ns = max(self._latest_ns.values(), default=stamp_ns)
        is_of_its_time = own_ns - JUMP_BACK_NS <= stamp_ns <= end_ns + JUMP_BACK_NS
        if is_of_its_time and stamp_ns - new_ns > JUMP_BACK_NS:
            return True
        del self._ended_ns[source]
        return False
