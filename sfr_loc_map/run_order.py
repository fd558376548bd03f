"""Assignment of stamped items to runs, by their stamps and the stamps received earlier.

A run is one continuous sequence of stamps. A recording that is played again begins a new run. Where a stamp has another
meaning, such as the end of a path or the time of a clock, another rule holds (docs/nodes.md, "Time").

A single item whose stamp is 1 s or more before the last stamp of a run, or 1 h or more after, is a stray and is dropped
(`is_of_another_time`). If several such items arrive consecutively with increasing stamps, they are accepted. They begin
a new run if they are before the last stamp, and continue the run if they are ahead, because the clock was set.

- `RunOrder` requires items in the order of their stamps, such as the pairs of a rig.
- `AnyOrder` accepts items in any order, such as the poses that monitor and live page receive.
- `CommonRuns` begins a new run of several sources together, such as estimate and ground truth; each has an `AnyOrder`.
"""

from __future__ import annotations

from array import array
from bisect import bisect_left, insort
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from typing import Generic, TypeVar

from sfr_loc_map.message_stamps import JUMP_BACK_NS, jumped_back

T = TypeVar("T")
LEAP_NS = 3600 * 1_000_000_000
"""A stamp ahead of the last stamp by this many nanoseconds or more is taken to be from another clock."""
AGREEING = 3  #: Number of consecutive items of another time that are accepted if their stamps increase.
INCREASING = 10
"""Number of consecutive items with increasing stamps that begin a new run even if no stamp was received earlier. Only 1
of 3.6 million permutations of ten stamps increases."""
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


class RunOrder(Generic[T]):
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
        self.strays = 0
        self._agreeing = agreeing
        self._held: list[tuple[int, T]] = []

    def restart(self) -> None:
        """Forget the last stamp and the held items; the next item begins a run."""
        self.last_ns = None
        self._held.clear()

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
            self.strays += 1
            return [], False
        if last_ns is None or not is_of_another_time(last_ns, stamp_ns):
            if last_ns is not None and stamp_ns <= last_ns:
                self.late += 1
                return [], False
            self.strays += len(self._held)
            self._held.clear()
            self.last_ns = stamp_ns
            return [item], False
        if self._held and not continues_held(self._held[-1][0], last_ns, stamp_ns):
            self.strays += len(self._held)
            self._held.clear()
        self._held.append((stamp_ns, item))
        if len(self._held) < self._agreeing:
            return [], False
        self.last_ns = stamp_ns
        items = [held for _, held in self._held]
        self._held.clear()
        return items, stamp_ns < last_ns


@dataclass(frozen=True, slots=True)
class _OtherTime(Generic[T]):
    """An item of another time than the run of an `AnyOrder`."""

    stamp_ns: int
    item: T
    is_dropped: bool  #: Whether the item is dropped unless the items of another time are accepted together.


class AnyOrder(Generic[T]):
    """Assigns stamped items that arrive in any order to runs; `strays` counts the dropped items.

    An item of another time (`is_of_another_time`) is dropped if its stamp was received earlier or is an hour or more
    ahead. An item before the first stamp of the run waits, and is accepted once no gap separates the item from the run
    (`JOIN`). All other items are accepted. An item with a stamp of zero or less is dropped. If `is_once`, an item whose
    stamp was received earlier in the run is also dropped.

    Consecutive items of another time are accepted together if their stamps increase, are all before or all after the
    last stamp, and one of two conditions holds. Either `AGREEING` of them, and all, were dropped, as when a recording
    is played again or the clock is set forward. Or there are `INCREASING` items. Accepted items before the last stamp
    begin a new run. They then include those that were already accepted as late items of the previous run, because that
    run is discarded.
    """

    def __init__(self, *, is_once: bool = False) -> None:
        """Start before the first item."""
        self._is_once = is_once
        self._dropped = 0
        self._begin([])

    def restart(self) -> None:
        """Forget all items; the next item begins a run."""
        self._end_other_time()
        self._dropped += len(self._before_run)
        self._begin([])

    def _begin(self, stamps_ns: list[int]) -> None:
        self.repeated = 0  #: Number of dropped items whose stamp was received earlier in the run, if `is_once`.
        self._stamps_ns = array("q", stamps_ns)  # accepted stamps of the run, sorted; 8 bytes each
        self._before_run: list[tuple[int, T]] = []  # items that wait to join the run, sorted by stamp
        self._other_time: list[_OtherTime[T]] = []  # consecutive items that may begin or continue a run

    def release(self) -> list[T]:
        """Restart, because another source has begun a run, and return the items that may belong to that run."""
        items = self._take_other_time()
        self._begin([])
        return items

    @property
    def strays(self) -> int:
        """Number of items dropped so far, including items before the run that have not joined the run."""
        return self._dropped + sum(held.is_dropped for held in self._other_time) + len(self._before_run)

    def add(self, stamp_ns: int, item: T) -> tuple[list[T], bool]:
        """Add an item; return the items that are accepted, and whether a new run begins with them."""
        if stamp_ns <= 0:
            self._dropped += 1
            return [], False
        if not self._stamps_ns or not is_of_another_time(self._stamps_ns[-1], stamp_ns):
            self._end_other_time()
            if self._is_once and self._was_received(stamp_ns):
                self._dropped += 1
                self.repeated += 1
                return [], False
            return self._accept(stamp_ns, item), False
        first_ns = self._stamps_ns[0]
        last_ns = self._stamps_ns[-1]
        if self._other_time and not continues_held(self._other_time[-1].stamp_ns, last_ns, stamp_ns):
            self._end_other_time()
        is_ahead = stamp_ns > last_ns
        is_dropped = is_ahead or self._was_received(stamp_ns)
        self._other_time.append(_OtherTime(stamp_ns, item, is_dropped))
        if self._is_other_time_accepted():
            return self._take_other_time(), not is_ahead
        if is_dropped:
            return [], False
        if stamp_ns < first_ns:
            insort(self._before_run, (stamp_ns, item), key=lambda waiting: waiting[0])
            return self._joined(), False
        return self._accept(stamp_ns, item), False

    def _was_received(self, stamp_ns: int) -> bool:
        """Return whether an item of the run has this stamp."""
        index = bisect_left(self._stamps_ns, stamp_ns)
        return index < len(self._stamps_ns) and self._stamps_ns[index] == stamp_ns

    def _accept(self, stamp_ns: int, item: T) -> list[T]:
        """Accept an item of the run; return the item, and the items before the run that join now."""
        insort(self._stamps_ns, stamp_ns)
        return [item, *self._joined()]

    def _joined(self) -> list[T]:
        """Accept and return the items before the run that no gap separates from the run."""
        joined: list[T] = []
        while self._before_run and len(self._stamps_ns) > 1:
            stamp_ns, item = self._before_run[-1]
            step_ns = (self._stamps_ns[-1] - self._stamps_ns[0]) / (len(self._stamps_ns) - 1)
            if self._stamps_ns[0] - stamp_ns > JOIN * step_ns:
                break
            self._before_run.pop()
            self._stamps_ns.insert(0, stamp_ns)
            joined.append(item)
        return joined

    def _is_other_time_accepted(self) -> bool:
        """Return whether the consecutive items of another time are accepted together."""
        count = len(self._other_time)
        return count >= INCREASING or (count >= AGREEING and all(held.is_dropped for held in self._other_time))

    def _take_other_time(self) -> list[T]:
        """Forget all but the consecutive items of another time, and return these."""
        stamps_ns = [held.stamp_ns for held in self._other_time]
        items = [held.item for held in self._other_time]
        self._dropped += sum(stamp_ns not in stamps_ns for stamp_ns, _ in self._before_run)
        self._begin(stamps_ns)
        return items

    def _end_other_time(self) -> None:
        """Drop the consecutive items of another time that were not accepted individually."""
        self._dropped += sum(held.is_dropped for held in self._other_time)
        self._other_time.clear()


class CommonRuns(Generic[T]):
    """Assigns the stamped items of several sources to common runs.

    The first source that begins a new run begins it for all sources. Items that the other sources hold for a new run
    are then accepted. Late items of the previous run are dropped until their source sends a stamp that fits the new
    run. Otherwise results of the previous run, which arrive later than the ground truth of the same stamp, would
    restart that run.
    """

    def __init__(self, sources: Iterable[str], once: Collection[str] = ()) -> None:
        """Start before the first item of any source. `once` are the sources whose repeated stamps are dropped."""
        self._orders = {source: AnyOrder[tuple[str, int, T]](is_once=source in once) for source in sources}
        self._latest_ns: dict[str, int] = {}  # latest stamp of each source in the run
        # latest stamps of the previous run, by source: of the source and of all
        self._ended_ns: dict[str, tuple[int, int]] = {}

    @property
    def strays(self) -> int:
        """Number of items dropped so far because of their stamps."""
        return sum(order.strays for order in self._orders.values())

    def repeated(self, source: str) -> int:
        """Return the number of dropped items of a source whose stamp was received earlier in the present run."""
        return self._orders[source].repeated

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
