"""Pairs of stamped items: each common stamp is paired, and unpaired items are bounded."""

from __future__ import annotations

import random

from hypothesis import given
from hypothesis import strategies as st

from sfr_loc_map.stamp_pairing import StampPairing, match_stamps


def paired(
    order: list[tuple[str, int]], tolerance: int = 0, depth: int = 1000
) -> tuple[list[tuple[int, int]], StampPairing[int]]:
    pairing: StampPairing[int] = StampPairing(tolerance, depth)
    found = [getattr(pairing, f"add_{side}")(stamp, stamp) for side, stamp in order]
    return [pair for pair in found if pair], pairing


def interleaved(left: list[int], right: list[int], choice: random.Random) -> list[tuple[str, int]]:
    queues, order = {"left": [*left], "right": [*right]}, []
    while any(queues.values()):
        side = choice.choice([name for name, queue in queues.items() if queue])
        order.append((side, queues[side].pop(0)))
    return order


@given(st.sets(st.integers(0, 40)), st.sets(st.integers(0, 40)), st.randoms())
def test_every_common_stamp_is_paired_whatever_the_interleaving(
    left: set[int], right: set[int], choice: random.Random
) -> None:
    found, pairing = paired(interleaved(sorted(left), sorted(right), choice))
    assert found == [(stamp, stamp) for stamp in sorted(left & right)]
    lonely = [s for own, other in ((left, right), (right, left)) for s in own - other if s < max(other, default=-1)]
    assert (pairing.unpaired, pairing.overflowed) == (len(lonely), 0)


@given(st.randoms(), st.integers(1, 6))
def test_a_new_run_loses_no_pair_though_one_stream_begins_it_first(choice: random.Random, count: int) -> None:
    stamps = [*range(10, 10 + count), *range(count), *range(20, 20 + count)]
    found, _ = paired(interleaved(stamps, stamps, choice))
    assert sorted(found) == sorted((stamp, stamp) for stamp in stamps)


def test_within_the_tolerance_the_nearest_is_taken_and_what_waits_is_bounded() -> None:
    found, pairing = paired([("left", 0), ("left", 100), ("right", 96)], tolerance=100)
    assert (found, pairing.unpaired) == ([(100, 96)], 1)
    assert paired([("left", 0), ("right", 11)], tolerance=10)[0] == []
    found, pairing = paired([("left", i) for i in range(10)] + [("right", i) for i in range(10)], depth=3)
    assert found == [(7, 7), (8, 8), (9, 9)]
    # 7 of the left fell out; of the right, 0 to 6 come when the left has gone past them
    assert (pairing.overflowed, pairing.unpaired) == (7, 7)


@given(st.integers(3, 40), st.integers(-10, 10), st.sets(st.integers(0, 30)), st.sets(st.integers(0, 30)))
def test_no_pair_is_one_of_neighbouring_moments(period: int, apart: int, no_left: set[int], no_right: set[int]) -> None:
    """However large the tolerance: the partner is the one of the same moment, or none."""
    apart = max(min(apart, (period - 1) // 2), -(period - 1) // 2 + 1)
    moments = range(32)
    left, right = ([i for i in moments if i not in out] for out in (no_left & {0, 3, 9}, no_right & {1, 3, 20}))
    found = match_stamps([i * period for i in left], [i * period + apart for i in right], 10 * period)
    assert found == {i * period: i * period + apart for i in left if i in right}
