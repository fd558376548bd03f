"""What the transport lost, counted from the sequence numbers of publishers."""

from hypothesis import given
from hypothesis import strategies as st

from sfr_loc_map.pipeline.reception import LossWatch, TransportGaps


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


def test_a_middleware_without_numbers_counts_nothing() -> None:
    assert lost([None, None, None]) == 0
    assert lost([0, 0]) == 0


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
