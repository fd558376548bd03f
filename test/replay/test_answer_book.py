"""Answers of an external node: early answers are a finding, late answers count as missing, latencies are unchanged."""

from __future__ import annotations

import time

import pytest

from sfr_loc_map.metrics.figures.records import CallFinding, FindingKind
from sfr_loc_map.replay.external.answer_book import EARLY_S, MAX_EARLY, MAX_IN_A_ROW, AnswerBook

TIMEOUT_S = 1.0
PAIR_NS = 1_000


@pytest.fixture
def book(monkeypatch: pytest.MonkeyPatch) -> AnswerBook[int]:
    """A book whose answers are received at 10 s."""
    monkeypatch.setattr(time, "monotonic", lambda: 10.0)
    return AnswerBook[int](TIMEOUT_S, "ds -> rb")


def findings_of(book: AnswerBook[int]) -> list[FindingKind]:
    return [item.kind for item in book.findings]


@pytest.mark.parametrize(("ahead_s", "is_early"), [(0.08, True), (EARLY_S + 0.001, True), (EARLY_S - 0.001, False)])
def test_an_answer_before_its_pair_is_early(book: AnswerBook[int], ahead_s: float, is_early: bool) -> None:
    assert book.note_answer(PAIR_NS, "ds -> rb", None, PAIR_NS) is None, "it is kept for its pair"
    assert book.note_sent(PAIR_NS, 10.0 + ahead_s) == PAIR_NS
    assert findings_of(book) == ([FindingKind.EARLY] if is_early else [])
    assert FindingKind.EARLY.fails
    assert book.counts.early == is_early
    assert book.latency_s is not None
    assert book.latency_s.mean == pytest.approx(-ahead_s)


@pytest.mark.parametrize(("latency_s", "is_late"), [(0.999, False), (1.001, True)])
def test_an_answer_after_its_time_is_none(book: AnswerBook[int], latency_s: float, is_late: bool) -> None:
    book.note_sent(PAIR_NS, 10.0 - latency_s)
    assert book.note_answer(PAIR_NS, "ds -> rb", None, PAIR_NS) == (None if is_late else PAIR_NS)
    assert findings_of(book) == ([FindingKind.LATE, FindingKind.MISSING] if is_late else [])
    assert (book.counts.answered, book.counts.missing, book.counts.late) == (not is_late, is_late, is_late)
    assert book.latency_s is not None
    assert book.latency_s.mean == pytest.approx(latency_s), "its time counts all the same"


@pytest.mark.parametrize("latency_s", [0.5, 1.5, -0.05])
def test_only_the_first_answer_in_time_is_used(book: AnswerBook[int], latency_s: float) -> None:
    """A node that repeats its answers, perhaps with corrected poses, is judged by the poses that it gave in time."""
    is_early, is_late = latency_s < 0.0, latency_s > TIMEOUT_S
    used = []
    if not is_early:
        used.append(book.note_sent(PAIR_NS, 10.0 - latency_s))
    used += [book.note_answer(PAIR_NS, "ds -> rb", None, content) for content in (1, 2)]
    if is_early:
        used.append(book.note_sent(PAIR_NS, 10.0 - latency_s))
    used.append(book.note_answer(PAIR_NS, "ds -> rb", None, 3))
    assert [content for content in used if content is not None] == ([] if is_late else [1])
    assert (book.counts.answered, book.counts.late, book.counts.doubled) == (not is_late, is_late, 2)


def test_the_frames_of_a_late_answer_are_not_required_of_others(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time, "monotonic", lambda: 10.0)
    book = AnswerBook[int](TIMEOUT_S, None)
    book.note_sent(PAIR_NS, 10.0 - TIMEOUT_S - 0.1)
    assert book.note_answer(PAIR_NS, "map", None, 1) is None
    book.note_sent(2 * PAIR_NS, 10.0)
    assert book.note_answer(2 * PAIR_NS, "odom", None, 2) == 2
    assert (book.frames, book.counts.other_frame) == ("odom", 0)


@pytest.mark.parametrize("kind", [FindingKind.NOT_FINITE, FindingKind.INVALID_RESULT])
def test_an_unusable_answer_is_a_finding_of_its_kind(book: AnswerBook[int], kind: FindingKind) -> None:
    book.note_sent(PAIR_NS, 10.0)
    assert book.note_answer(PAIR_NS, "ds -> rb", CallFinding(kind, "why"), 1) is None
    (finding,) = [item for item in book.findings if item.kind is kind]
    assert (finding.text, book.counts.not_usable, book.counts.answered) == ("why", 1, 0)


def test_a_crash_has_the_stamp_of_the_pair_that_was_sent_last(book: AnswerBook[int]) -> None:
    for stamp_ns in (2 * PAIR_NS, PAIR_NS):
        book.note_sent(stamp_ns, 10.0)
    book.note_end("killed")
    assert book.findings[0].first_stamp_ns == PAIR_NS


def test_a_node_that_was_started_again_has_crashed(book: AnswerBook[int]) -> None:
    book.note_sent(PAIR_NS, 9.9)
    book.note_restart("the publisher has left")
    book.note_restart("the publisher has left")
    (finding,) = [item for item in book.findings if item.kind is FindingKind.CRASHED]
    assert (finding.count, finding.first_stamp_ns) == (1, PAIR_NS)
    assert not book.ended, "the process that came in its place is waited for"


def test_an_early_answer_that_was_dropped_is_not_an_answer(book: AnswerBook[int]) -> None:
    for stamp_ns in range(MAX_EARLY + 2):
        assert book.note_answer(stamp_ns, "ds -> rb", None, stamp_ns) is None
    assert book.counts.other_stamp == MAX_EARLY + 2
    (finding,) = [item for item in book.findings if item.kind is FindingKind.WRONG_STAMP]
    assert (finding.count, finding.first_stamp_ns) == (MAX_EARLY + 2, 0)
    assert [book.note_sent(stamp_ns, 10.0) for stamp_ns in (1, 2)] == [None, 2]
    assert (book.counts.answered, book.counts.missing, book.counts.other_stamp) == (1, 1, MAX_EARLY + 1)


@pytest.mark.parametrize("repeats_its_first_stamp", [False, True])
def test_answers_to_no_pair_do_not_prolong_the_replay(book: AnswerBook[int], repeats_its_first_stamp: bool) -> None:
    """A node that answers each pair with a wrong stamp is no longer awaited after `MAX_IN_A_ROW` pairs."""
    book.note_sent(0, 10.0)
    book.note_answer(0, "ds -> rb", None, 0)
    for stamp_ns in range(PAIR_NS, (MAX_IN_A_ROW + 1) * PAIR_NS, PAIR_NS):
        book.note_sent(stamp_ns, 10.0)
        assert not book.is_settled(stamp_ns)
        book.note_answer(0 if repeats_its_first_stamp else stamp_ns + 1, "ds -> rb", None, 0)
        book.note_waited(stamp_ns)
    book.note_sent(-PAIR_NS, 10.0)
    assert book.is_settled(-PAIR_NS)


@pytest.mark.parametrize("frames", ["odom -> base_link", "odom", ""])
def test_only_an_answer_to_a_pair_determines_the_frames(monkeypatch: pytest.MonkeyPatch, frames: str) -> None:
    """The frames of an answer to no pair, or of an unusable answer, are not required of others; "" is a frame, too."""
    monkeypatch.setattr(time, "monotonic", lambda: 10.0)
    book = AnswerBook[int](TIMEOUT_S, None)
    book.note_sent(PAIR_NS, 10.0)
    book.note_answer(99, "wrong", None, 0)
    book.note_answer(PAIR_NS, "wrong", CallFinding(FindingKind.NOT_FINITE, "NaN"), 0)
    assert book.note_answer(PAIR_NS, frames, None, 1) == 1
    book.note_sent(2 * PAIR_NS, 10.0)
    assert book.note_answer(2 * PAIR_NS, "map", None, 2) is None
    assert (book.frames, book.counts.other_frame, book.counts.other_stamp) == (frames, 1, 1)
    assert book.note_answer(2 * PAIR_NS, frames, None, 3) == 3


@pytest.mark.parametrize("required", ["odom", None])
def test_the_frames_of_an_early_answer_are_checked_once_its_pair_is_published(
    monkeypatch: pytest.MonkeyPatch, required: str | None
) -> None:
    monkeypatch.setattr(time, "monotonic", lambda: 10.0)
    book = AnswerBook[int](TIMEOUT_S, required)
    for content, frames in enumerate(["odom", "wrong", "odom"]):
        assert book.note_answer(PAIR_NS, frames, None, content) is None
    assert book.note_sent(PAIR_NS, 10.0) == 0
    book.note_answer(2 * PAIR_NS, "wrong", None, 4)
    book.note_answer(2 * PAIR_NS, "odom", None, 5)
    assert book.note_sent(2 * PAIR_NS, 10.0) == 5
    assert (book.counts.other_frame, book.counts.doubled, book.counts.answered) == (2, 1, 2)


@pytest.mark.parametrize("is_known", [False, True])
def test_answers_with_other_frames_are_no_answers_with_a_wrong_stamp(book: AnswerBook[int], is_known: bool) -> None:
    """Another node may publish on the same topic at other times: its frames tell the answers apart."""
    if not is_known:
        book.frames = None
        book.note_sent(PAIR_NS, 10.0)
        book.note_answer(PAIR_NS, "ds -> rb", None, 0)
    for stamp_ns in range(5):
        assert book.note_answer(stamp_ns, "odom -> base_link", None, 1) is None
    assert (book.counts.other_frame, book.counts.other_stamp) == (5, 0)
