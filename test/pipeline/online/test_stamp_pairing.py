from hypothesis import given
from hypothesis import strategies as st

from sfr_loc_map.pipeline.online.stamp_pairing import StampPairing


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
    last = max(left & right, default=-1)
    lonely = [stamp for stamp in left ^ right if stamp < last]
    assert pairing.unpaired == len(lonely)
    assert pairing.overflowed == 0


def test_waiting_items_are_bounded_and_overflow_is_counted() -> None:
    found, pairing = run([("left", i) for i in range(10)] + [("right", i) for i in range(10)], depth=3)
    assert found == [(7, 7), (8, 8), (9, 9)]
    # 7 of the left fell out; of the right, 0 to 6 wait in vain: 4 overflow, the last 3 are older than the pair of 7.
    assert pairing.overflowed == 7 + 4
    assert pairing.unpaired == 3


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
