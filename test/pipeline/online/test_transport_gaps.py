"""What the transport lost, counted from the sequence numbers of publishers."""

from hypothesis import given
from hypothesis import strategies as st

from sfr_loc_map.pipeline.online.transport_gaps import TransportGaps


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
