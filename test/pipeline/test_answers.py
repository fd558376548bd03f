"""What is noted of an external node's answers: each pair once, each fault by its name."""

from __future__ import annotations

from sfr_loc_map.metrics.score import FindingKind
from sfr_loc_map.pipeline.external_run import MAX_IN_A_ROW, Answer, AnswerBook


class Clock:
    """A clock that is set by hand."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


def book_with(pairs: int, clock: Clock, frames: str = "") -> AnswerBook:
    book = AnswerBook("loc", 1.0, frames, clock)
    for stamp_ns in range(pairs):
        book.published(stamp_ns, clock.now_s)
    return book


def test_each_kind_of_answer_is_counted_and_used_or_not() -> None:
    clock = Clock()
    book = book_with(4, clock)
    clock.now_s += 0.25
    assert book.received(Answer(0, "odom -> base"))
    assert book.received(Answer(0, "odom -> base"))
    assert book.received(Answer(77, "odom -> base"))  # of no pair: it counts by interpolation
    assert not book.received(Answer(1, "odom -> imu"))
    assert not book.received(Answer(1, "odom -> base", "a number is not finite"))
    clock.now_s += 1.0
    assert book.received(Answer(2, "odom -> base"))
    counts = book.counts
    assert (counts.pairs, counts.answered, counts.missing) == (4, 2, 2)
    assert (counts.doubled, counts.other_stamp, counts.other_frame, counts.not_usable, counts.late) == (1, 1, 1, 1, 1)
    assert book.latency_s is not None
    assert (book.latency_s.count, book.latency_s.mean, book.latency_s.max) == (2, 0.75, 1.25)
    assert {item.kind for item in book.findings} == {
        FindingKind.DOUBLED,
        FindingKind.WRONG_STAMP,
        FindingKind.OTHER_FRAME,
        FindingKind.NOT_FINITE,
        FindingKind.LATE,
        FindingKind.MISSING,
    }
    missing = book.findings[-1]
    assert (missing.kind, missing.count, missing.first_stamp_ns) == (FindingKind.MISSING, 2, 1)


def test_an_answer_to_the_first_image_alone_is_one_to_the_pair() -> None:
    clock = Clock()
    book = book_with(0, clock)
    assert book.received(Answer(5, "odom -> base"))
    assert book.counts.other_stamp == 1
    clock.now_s += 0.01
    book.published(5, clock.now_s)
    assert book.is_settled(5)
    assert (book.counts.other_stamp, book.counts.answered, book.findings) == (0, 1, ())
    assert book.latency_s is not None
    assert book.latency_s.max == 0.0


def test_frames_that_are_declared_are_those_that_count() -> None:
    book = book_with(1, Clock(), "map -> camera")
    assert not book.received(Answer(0, "odom -> base"))
    assert book.received(Answer(0, "map -> camera"))


def test_a_pair_is_waited_for_until_its_time_is_over() -> None:
    clock = Clock()
    book = book_with(1, clock)
    assert not book.is_settled(0)
    clock.now_s += 1.1
    assert book.is_settled(0)
    assert AnswerBook("loc", 1.0, clock=clock).latency_s is None


def test_a_node_that_does_not_answer_is_given_up_until_it_answers() -> None:
    clock = Clock()
    book = book_with(MAX_IN_A_ROW + 2, clock)
    for stamp_ns in range(MAX_IN_A_ROW):
        assert not book.is_settled(stamp_ns + 1)
        book.waited(stamp_ns)
    assert book.is_settled(MAX_IN_A_ROW)
    assert book.findings[-1].kind is FindingKind.HANGING
    assert book.received(Answer(3, ""))
    assert not book.is_settled(MAX_IN_A_ROW)
    assert book.findings[-1].kind is FindingKind.MISSING


def test_a_node_that_ended_is_not_waited_for() -> None:
    book = book_with(3, Clock())
    book.node_ended("was killed by SIGSEGV")
    book.node_ended("again")
    assert book.is_settled(2)
    assert book.ended == "was killed by SIGSEGV"
    assert [item.kind for item in book.findings] == [FindingKind.CRASHED, FindingKind.MISSING]
    assert book.findings[0].first_stamp_ns == 2
