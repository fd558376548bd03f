"""Gaps in the sequence numbers of messages are counted for each publisher."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from sfr_loc_map.ros.transport import TransportGaps


def lost(numbers: list[int | None]) -> int:
    gaps = TransportGaps()
    return sum(gaps.add({"publication_sequence_number": number}) for number in numbers)


@given(st.integers(1, 10_000), st.lists(st.booleans(), min_size=1, max_size=50))
def test_every_gap_between_two_messages_that_came_counts(first: int, came: list[bool]) -> None:
    numbers = [first, *(first + 1 + i for i, there in enumerate(came) if there)]
    assert lost([*numbers]) == numbers[-1] - first + 1 - len(numbers)
    assert lost([7, 8, 10, 1, 2, 4]) == 2  # a new publisher lost nothing
    assert lost([None, None, 0, 0]) == 0  # a middleware without numbers


def test_of_several_publishers_no_gap_is_counted() -> None:
    gaps = TransportGaps()
    gaps.set_several(True)
    assert sum(gaps.add({"publication_sequence_number": number}) for number in (1, 9, 2, 10, 3, 11)) == 0


def test_another_publisher_leaves_the_count_of_earlier_losses() -> None:
    gaps = TransportGaps()

    def add(*numbers: int) -> None:
        for number in numbers:
            gaps.add({"publication_sequence_number": number})

    add(1, 3, 5)
    gaps.set_several(False)
    add(6, 500)  # the first number of another publisher, before it is detected
    gaps.set_several(True)
    assert gaps.lost == 2
    add(7, 501, 9)
    gaps.set_several(False)
    add(502, 504)  # the other one has stayed
    assert gaps.lost == 3


def test_a_number_that_does_not_increase_is_that_of_another_publisher() -> None:
    for numbers, returns in (
        ([1, 2, 3, 1, 2, 3], 1),
        ([1, 1, 2, 2, 3, 3], 3),
        ([50, 7, 51, 8, 52, 9], 3),
        ([1, 2, 4, 9], 0),
        ([0] * 9, 0),  # a middleware without numbers
        ([2**64 - 1] * 9, 0),
    ):
        gaps = TransportGaps()
        for number in numbers:
            gaps.add({"publication_sequence_number": number})
        assert (gaps.returns, gaps.before) == (returns, max(numbers[0] % (2**64 - 1) - 1, 0)), numbers


def test_another_publisher_is_also_found_beside_or_after_a_second_one() -> None:
    """Two processes have a publisher, and the second one publishes after the first has ended."""
    for is_first_left in (False, True):
        gaps = TransportGaps()
        gaps.set_several(True)
        gaps.add({"publication_sequence_number": 9})
        gaps.set_several(not is_first_left)
        gaps.add({"publication_sequence_number": 1})
        assert gaps.returns == 1


def test_what_is_published_between_two_subscriptions_is_not_lost() -> None:
    gaps = TransportGaps()
    found = [gaps.add({"publication_sequence_number": number}) for number in (1, 3)]
    gaps.begin_subscription()
    found += [gaps.add({"publication_sequence_number": number}) for number in (50, 52)]
    assert found == [0, 1, 0, 1]
    assert gaps.lost == 2


def test_messages_before_the_first_subscription_are_counted_apart_from_losses() -> None:
    for numbers, before in (([1, 2], 0), ([7, 9, 1], 6), ([None, 5], 0)):
        gaps = TransportGaps()
        lost_ones = [gaps.add({"publication_sequence_number": number}) for number in numbers]
        assert (gaps.before, lost_ones[0]) == (before, 0)
