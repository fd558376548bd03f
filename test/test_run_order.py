"""Runs of stamped items: stray items are dropped and counted; a restart or another clock starts a new run."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from sfr_loc_map.run_order import LEAP_NS, AnyOrder, CommonRuns, RunOrder

S = 1_000_000_000


RUN = tuple(10**9 * k for k in range(100, 120))


def processed(stamps_ns: list[int], agreeing: int = 3) -> tuple[list[int], list[int], RunOrder[int]]:
    """Return the stamps that are processed, those that begin a run, and the order after them."""
    order, done, begun = RunOrder[int](agreeing), list[int](), list[int]()
    for stamp_ns in stamps_ns:
        items, begins = order.add(stamp_ns, stamp_ns)
        begun += items[:1] if begins else []
        done += items
    return done, begun, order


@pytest.mark.parametrize(
    "strays",
    [
        [RUN[5] - 3 * 10**9],  # an old image among newer ones
        [0],  # no stamp
        [
            RUN[5] - 3 * 10**9,
            RUN[5] - 4 * 10**9,
            RUN[5] - 5 * 10**9,
            RUN[5] - 6 * 10**9,
        ],  # that do not follow each other
        [RUN[5] - 5 * 10**9, RUN[5] - 4 * 10**9],  # too few
        [RUN[5] + 10 * LEAP_NS],  # another clock
        [0] * 20,
    ],
)
def test_strays_are_dropped_and_counted_and_the_run_goes_on(strays: list[int]) -> None:
    done, begun, order = processed([*RUN[:6], *strays, *RUN[6:]])
    assert (done, begun, order.strays) == ([*RUN], [], len(strays))


def test_held_items_of_both_sides_of_the_run_are_never_accepted_together() -> None:
    """A stray of the past must not continue the run with two items of the future."""
    order: RunOrder[int] = RunOrder()
    last = 10 * LEAP_NS
    order.add(last, last)
    assert [order.add(stamp, stamp) for stamp in (5 * LEAP_NS, 12 * LEAP_NS, 12 * LEAP_NS + 1)] == [([], False)] * 3
    assert order.add(12 * LEAP_NS + 2, 0) == ([12 * LEAP_NS, 12 * LEAP_NS + 1, 0], False)
    assert order.strays == 1


def test_a_run_that_begins_again_loses_nothing() -> None:
    done, begun, order = processed([*RUN, *RUN])
    assert (done, begun, order.strays, order.late) == ([*RUN, *RUN], [RUN[0]], 0, 0)


def test_a_clock_that_is_set_forward_goes_on_and_late_items_are_counted() -> None:
    ahead = [stamp + 2 * LEAP_NS for stamp in RUN]
    assert processed([*RUN, *ahead])[:2] == ([*RUN, *ahead], [])
    done, begun, order = processed([RUN[0], RUN[1], RUN[1], RUN[1] - 10**8, RUN[2]])
    assert (done, begun, order.late) == ([*RUN[:3]], [], 2)


def test_a_map_of_one_pair_has_one_stamp_of_its_run() -> None:
    done, begun, _ = processed([RUN[3], RUN[0]], agreeing=1)
    assert (done, begun) == ([RUN[3], RUN[0]], [RUN[0]])


def accepted(stamps_ns: Sequence[int]) -> tuple[list[int], list[int], AnyOrder[int]]:
    """Return the stamps of the last run, the first one of each new run, and the order after them."""
    order, run, begun = AnyOrder[int](), list[int](), list[int]()
    for stamp_ns in stamps_ns:
        items, begins = order.add(stamp_ns, stamp_ns)
        if begins:
            begun.append(items[0])
            run.clear()
        run += items
    return run, begun, order


@pytest.mark.parametrize("stray_ns", [0, RUN[0] + 10 * LEAP_NS])
def test_a_shuffled_drive_is_one_run_and_a_stray_among_it_is_dropped(stray_ns: int) -> None:
    rng = np.random.default_rng(2)
    for count in (20, 400):
        drive = [RUN[0] + 10**8 * k for k in range(count)]
        for _ in range(300):
            order = rng.permutation(drive).tolist()
            run, begun, after = accepted(order)
            assert (sorted(run), begun, after.strays) == (drive, [], 0)
        run, begun, after = accepted([*order[:7], stray_ns, *order[7:]])
        assert (sorted(run), begun, after.strays) == (drive, [], 1)


def test_items_received_before_and_items_ahead_are_never_accepted_together() -> None:
    """Two repeated items and an item of another clock must not be added to the run again."""
    ahead = [RUN[-1] + 2 * LEAP_NS + k for k in range(3)]
    run, begun, order = accepted([*RUN, RUN[0], RUN[1], *ahead[:2]])
    assert (run, begun, order.strays) == ([*RUN], [], 4)
    run, begun, order = accepted([*RUN, RUN[0], RUN[1], *ahead])
    assert (run, begun, order.strays) == ([*RUN, *ahead], [], 2)


@pytest.mark.parametrize("phase_ns", [0, 4 * 10**8, -50 * 10**9])
@pytest.mark.parametrize("lost", [(), (1,), (2, 3)])
def test_a_run_that_begins_again_is_a_new_one_of_any_phase(phase_ns: int, lost: tuple[int, ...]) -> None:
    again = [stamp + phase_ns for index, stamp in enumerate(RUN) if index not in lost]
    run, begun, _ = accepted([*RUN, *again])
    assert (run, begun) == (again, again[:1])


def test_a_pose_that_is_sent_again_or_is_of_another_time_is_dropped_and_counted() -> None:
    for stray_ns in (0, RUN[0] - 5 * 10**9, RUN[0] + 10 * LEAP_NS):
        run, begun, order = accepted([*RUN[:10], stray_ns, *RUN[10:]])
        assert (run, begun, order.strays) == ([*RUN], [], 1)
    run, begun, order = accepted([*RUN[:10], RUN[4], *RUN[10:]])
    assert (run, begun, order.strays) == ([*RUN], [], 1)
    run, begun, order = accepted([*RUN[:10], RUN[4] + 1000, *RUN[10:]])  # a late one of its own
    assert (sorted(run), begun, order.strays) == (sorted([*RUN, RUN[4] + 1000]), [], 0)


def common_runs() -> CommonRuns[int]:
    """Truth and estimate of one run, which have come to 20 s."""
    runs: CommonRuns[int] = CommonRuns(("truth", "estimate"))
    for second in range(15, 21):
        for source in ("truth", "estimate"):
            assert runs.add(source, second * S, second) == ([second], False)
    return runs


def begin_again(runs: CommonRuns[int], source: str, seconds: Sequence[int]) -> list[int]:
    """Add items of a source until a new run begins; return what is accepted with it."""
    for second in seconds:
        accepted, begins_run = runs.add(source, second * S, second)
        if begins_run:
            return accepted
        assert accepted == []
    raise AssertionError("no run has begun")


def test_results_of_the_run_before_do_not_begin_another_one() -> None:
    runs = common_runs()
    assert begin_again(runs, "truth", (15, 16, 17)) == [15, 16, 17]
    for stamp_ns in (20 * S, 20 * S + 100):  # of the run before
        assert runs.add("estimate", stamp_ns, 0) == ([], False)
    for second in (15, 16, 17, 18, 19, 20):  # of the new run, to the end of the one before
        assert runs.add("estimate", second * S, second) == ([second], False)
    assert runs.strays == 0


def test_a_source_with_another_clock_keeps_its_time_when_the_other_begins_again() -> None:
    runs = common_runs()
    begin_again(runs, "truth", (15, 16, 17))
    assert runs.add("estimate", 22 * S, 22) == ([22], False)


def test_items_that_are_held_when_the_other_source_begins_a_run_are_part_of_it() -> None:
    runs = common_runs()
    for second in (15, 16):
        assert runs.add("estimate", second * S, 100 + second) == ([], False)
    assert begin_again(runs, "truth", (15, 16, 17)) == [15, 16, 17, 115, 116]
    assert runs.add("estimate", 17 * S, 117) == ([117], False)
    assert runs.strays == 0


def test_a_clock_that_is_set_back_begins_a_run_with_the_next_item() -> None:
    order = RunOrder[int]()
    assert not order.restart_if_set_back(5 * S), "nothing was received"
    order.add(10 * S, 10)
    assert not order.restart_if_set_back(9 * S + 1), "less than a second"
    assert order.restart_if_set_back(9 * S)
    assert order.add(2 * S, 2) == ([2], False)


def test_a_repeated_stamp_is_dropped_and_counted_where_each_stamp_occurs_once() -> None:
    runs = CommonRuns[str](("estimate", "truth"), once=("truth",))
    for source in ("estimate", "truth"):
        for item in ("first", "again"):
            accepted, begins_run = runs.add(source, RUN[0], item)
            assert not begins_run
            assert accepted == ([] if (source, item) == ("truth", "again") else [item])
    assert (runs.strays, runs.repeated("truth"), runs.repeated("estimate")) == (1, 1, 0)
