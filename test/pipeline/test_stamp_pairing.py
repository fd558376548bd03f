from hypothesis import given
from hypothesis import strategies as st

from sfr_loc_map.pipeline.reception import StampPairing


def run(
    order: list[tuple[str, int]], tolerance: int = 0, depth: int = 1000
) -> tuple[list[tuple[int, int]], StampPairing]:
    pairing: StampPairing[int] = StampPairing(tolerance, depth)
    found = []
    for side, stamp in order:
        pair = pairing.add_left(stamp, stamp) if side == "left" else pairing.add_right(stamp, stamp)
        if pair:
            found.append(pair)
    return found, pairing


@given(st.sets(st.integers(0, 40)), st.sets(st.integers(0, 40)), st.randoms())
def test_every_common_stamp_is_paired_whatever_the_interleaving(left: set[int], right: set[int], random) -> None:  # noqa: ANN001
    queues = {"left": sorted(left), "right": sorted(right)}
    order = []
    while any(queues.values()):
        side = random.choice([name for name, queue in queues.items() if queue])
        order.append((side, queues[side].pop(0)))
    found, pairing = run(order)
    assert found == [(stamp, stamp) for stamp in sorted(left & right)]
    lonely = [s for s in left - right if s < max(right, default=-1)] + [
        s for s in right - left if s < max(left, default=-1)
    ]
    assert pairing.unpaired == len(lonely)
    assert pairing.overflowed == 0


def test_waiting_items_are_bounded_and_overflow_is_counted() -> None:
    found, pairing = run([("left", i) for i in range(10)] + [("right", i) for i in range(10)], depth=3)
    assert found == [(7, 7), (8, 8), (9, 9)]
    # 7 of the left fell out; of the right, 0 to 6 come when the left has gone past them.
    assert pairing.overflowed == 7
    assert pairing.unpaired == 7


def test_what_can_have_no_partner_any_more_is_counted_at_once() -> None:
    order = [(side, stamp) for stamp in range(0, 500, 100) for side in ("left", "right")]
    found, pairing = run([(side, stamp + (side == "right")) for side, stamp in order])
    assert found == []
    assert pairing.unpaired == 9  # all but the last right one, whose partner may be on its way
    assert pairing.overflowed == 0


@given(st.randoms(), st.integers(1, 6))
def test_a_new_run_loses_no_pair_though_one_stream_begins_it_first(random, count: int) -> None:  # noqa: ANN001
    queues = {side: [*range(10, 10 + count), *range(count), *range(20, 20 + count)] for side in ("left", "right")}
    order = []
    while any(queues.values()):
        side = random.choice([name for name, queue in queues.items() if queue])
        order.append((side, queues[side].pop(0)))
    found, _ = run(order)
    assert sorted(found) == sorted((s, s) for s in [*range(10, 10 + count), *range(count), *range(20, 20 + count)])


def test_within_the_tolerance_the_nearest_is_taken() -> None:
    found, pairing = run([("left", 0), ("left", 100), ("right", 96)], tolerance=100)
    assert found == [(100, 96)]
    assert pairing.unpaired == 1
    assert run([("left", 0), ("right", 11)], tolerance=10)[0] == []
    assert run([("right", 0), ("left", 10)], tolerance=10)[0] == [(10, 0)]


def test_clear_forgets_without_counting() -> None:
    pairing: StampPairing[str] = StampPairing(0, 5)
    pairing.add_left(1, "a")
    pairing.clear()
    assert pairing.add_right(1, "b") is None
    assert (pairing.unpaired, pairing.overflowed) == (0, 0)
