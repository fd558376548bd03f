"""Messages as they are received: every pair found, what was lost counted, the path bounded."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.inputs import JUMP_BACK_NS
from sfr_loc_map.pipeline.reception import (
    LossWatch,
    MessageTimes,
    StampPairing,
    ThinnedPath,
    TransportGaps,
    jumped_back,
    latencies,
)


@pytest.mark.parametrize(
    ("back_ns", "jumped"), [(-JUMP_BACK_NS, False), (0, False), (JUMP_BACK_NS - 1, False), (JUMP_BACK_NS, True)]
)
def test_a_second_back_is_a_new_run(back_ns: int, jumped: bool) -> None:
    assert jumped_back(5 * JUMP_BACK_NS, 5 * JUMP_BACK_NS - back_ns) is jumped


def paired(
    order: list[tuple[str, int]], tolerance: int = 0, depth: int = 1000
) -> tuple[list[tuple[int, int]], StampPairing]:
    pairing: StampPairing[int] = StampPairing(tolerance, depth)
    found = []
    for side, stamp in order:
        pair = pairing.add_left(stamp, stamp) if side == "left" else pairing.add_right(stamp, stamp)
        if pair:
            found.append(pair)
    return found, pairing


def interleaved(left: list[int], right: list[int], random) -> list[tuple[str, int]]:  # noqa: ANN001
    queues, order = {"left": [*left], "right": [*right]}, []
    while any(queues.values()):
        side = random.choice([name for name, queue in queues.items() if queue])
        order.append((side, queues[side].pop(0)))
    return order


@given(st.sets(st.integers(0, 40)), st.sets(st.integers(0, 40)), st.randoms())
def test_every_common_stamp_is_paired_whatever_the_interleaving(left: set[int], right: set[int], random) -> None:  # noqa: ANN001
    found, pairing = paired(interleaved(sorted(left), sorted(right), random))
    assert found == [(stamp, stamp) for stamp in sorted(left & right)]
    lonely = [s for s in left - right if s < max(right, default=-1)] + [
        s for s in right - left if s < max(left, default=-1)
    ]
    assert pairing.unpaired == len(lonely)
    assert pairing.overflowed == 0


def test_waiting_items_are_bounded_and_overflow_is_counted() -> None:
    found, pairing = paired([("left", i) for i in range(10)] + [("right", i) for i in range(10)], depth=3)
    assert found == [(7, 7), (8, 8), (9, 9)]
    # 7 of the left fell out; of the right, 0 to 6 come when the left has gone past them.
    assert pairing.overflowed == 7
    assert pairing.unpaired == 7


@given(st.randoms(), st.integers(1, 6))
def test_a_new_run_loses_no_pair_though_one_stream_begins_it_first(random, count: int) -> None:  # noqa: ANN001
    stamps = [*range(10, 10 + count), *range(count), *range(20, 20 + count)]
    found, _ = paired(interleaved(stamps, stamps, random))
    assert sorted(found) == sorted((stamp, stamp) for stamp in stamps)


def test_within_the_tolerance_the_nearest_is_taken() -> None:
    found, pairing = paired([("left", 0), ("left", 100), ("right", 96)], tolerance=100)
    assert found == [(100, 96)]
    assert pairing.unpaired == 1
    assert paired([("left", 0), ("right", 11)], tolerance=10)[0] == []
    assert paired([("right", 0), ("left", 10)], tolerance=10)[0] == [(10, 0)]


S, MS = 1_000_000_000, 1_000_000
NOW = 1_800_000_000 * S


def test_each_part_is_taken_from_the_slowest_message() -> None:
    receipts = (MessageTimes(NOW - 50 * MS, NOW - 45 * MS), MessageTimes(NOW - 48 * MS, NOW - 40 * MS))
    found = latencies(receipts, NOW - 60 * MS, NOW, NOW)
    assert found == pytest.approx(
        {"latency_transport_s": 0.008, "latency_receive_to_publish_s": 0.040, "latency_stamp_to_publish_s": 0.060}
    )


@pytest.mark.parametrize("apart_s", [61, -1])
def test_clocks_that_do_not_agree_give_no_figure(apart_s: int) -> None:
    sent = NOW - apart_s * S
    found = latencies((MessageTimes(sent, NOW - 5 * MS),), sent, NOW, NOW)
    assert found == pytest.approx({"latency_receive_to_publish_s": 0.005})


def test_what_the_middleware_does_not_know_is_left_out() -> None:
    info = {"source_timestamp": 0, "received_timestamp": 5}
    assert MessageTimes.of(info) == MessageTimes(None, 5)
    assert MessageTimes.of({}) == MessageTimes(None, None)
    assert latencies((MessageTimes(None, None),), 0, NOW, NOW) == {}
    assert latencies((MessageTimes(None, NOW), MessageTimes(NOW, NOW)), 0, NOW, NOW) == {
        "latency_receive_to_publish_s": 0.0,
        "latency_transport_s": 0.0,
    }


def lost(numbers: list[int | None]) -> int:
    gaps = TransportGaps()
    for number in numbers:
        gaps.add({"publication_sequence_number": number})
    return gaps.lost


@given(st.integers(1, 10_000), st.lists(st.booleans(), min_size=1, max_size=50))
def test_every_gap_between_two_messages_that_came_counts(first: int, came: list[bool]) -> None:
    numbers: list[int | None] = [first, *(first + 1 + i for i, there in enumerate(came) if there)]
    last = numbers[-1]
    assert last is not None
    assert lost(numbers) == last - first + 1 - len(numbers)


def test_a_new_publisher_lost_nothing() -> None:
    assert lost([7, 8, 10, 1, 2, 4]) == 2
    assert lost([None, None, 0, 0]) == 0  # a middleware without numbers


def test_a_large_share_lost_is_told_with_what_the_publisher_needs() -> None:
    said: list[str] = []
    watch = LossWatch("images", "export A=/there/p.xml", said.append)
    for gap in [0] * 38 + [4]:  # 4 of 43 lost: below a tenth
        watch.add(gap)
    assert said == []
    for _ in range(20):
        watch.add(1)
    assert len(said) == 1
    assert said[0].startswith("50% of the images are lost in transport")
    assert "`export A=/there/p.xml`" in said[0]
    for _ in range(100):  # what was lost before does not count for ever
        watch.add(0)
    assert len(said) == 1


def along(x: float, turn: float = 0.0) -> Transform:
    return Transform(matrix_from_rotvec([0.0, 0.0, turn]) if turn else np.eye(3), np.array([x, 0.0, 0.0]))


def test_a_long_drive_stays_bounded_and_even() -> None:
    path: ThinnedPath[float] = ThinnedPath(100)
    for index in range(1500):
        path.add(index, along(0.05 * index), 0.05 * index)
        assert len(path.poses) <= 100
    assert path.poses[0] == 0.0
    assert path.poses[-1] == pytest.approx(0.05 * 1499)
    gaps = np.diff(path.poses[:-1])
    assert len(path.poses) >= 40
    assert gaps.max() <= 2.5 * gaps.min()


def test_a_rover_that_stands_leaves_one_pose_and_one_that_turns_leaves_more() -> None:
    path: ThinnedPath[int] = ThinnedPath()
    for index in range(500):
        path.add(index, along(1.0), index)
    assert path.poses == [0, 499]
    for index in range(500, 600):
        path.add(index, along(1.0, np.radians(index - 500.0)), index)
    assert 30 <= len(path.poses) <= 52


def test_stamps_that_go_back_start_a_new_path() -> None:
    path: ThinnedPath[int] = ThinnedPath()
    for index in (5, 6, 7, 3, 4):
        path.add(index, along(float(index)), index)
    assert path.poses == [3, 4]
    path.clear()
    assert path.poses == []
