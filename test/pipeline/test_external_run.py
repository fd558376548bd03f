"""An external node: each answer counted once, each fault by its name; what its processes used; its poses converted."""

from __future__ import annotations

import subprocess
import sys
import time

import psutil
import pytest

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.metrics.score import FindingKind
from sfr_loc_map.pipeline.external_run import MAX_IN_A_ROW, Answer, AnswerBook, ProcessWatch, processes_named


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


def test_a_node_that_does_not_answer_is_given_up_until_it_answers() -> None:
    clock = Clock()
    book = book_with(MAX_IN_A_ROW + 2, clock)
    for stamp_ns in range(MAX_IN_A_ROW):
        clock.now_s += 0.05
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


SIZE = 60_000_000
CHILD = f"import sys; data = bytearray({SIZE}); data[::4096] = bytes(len(data[::4096])); print('there', flush=True); "
CHILD += "n = sum(range(3_000_000)); sys.stdin.read()"
PARENT = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {CHILD!r}, 'a-mark-of-its-own'])"


def test_a_child_is_counted_with_its_parent_and_a_name_finds_it() -> None:
    with subprocess.Popen([sys.executable, "-c", PARENT], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as parent:
        assert parent.stdout is not None
        assert parent.stdin is not None
        watch = ProcessWatch([parent.pid], period_s=0.01)
        watch.start()
        parent.stdout.readline()
        (child,) = psutil.Process(parent.pid).children()
        assert child.pid in processes_named("a-mark-of-its-own")
        assert processes_named(str(parent.pid)) == [parent.pid]
        with pytest.raises(ConfigError, match="there is no such process"):
            processes_named("no process has this name, has it")
        time.sleep(0.1)
        parent.stdin.close()
        watch.stop()
        watch.stop()
    usage = watch.usage
    assert usage is not None
    assert usage.processes == 2
    assert SIZE < usage.peak_rss_bytes < SIZE + 100_000_000
    assert 0.01 < usage.cpu_s < 30.0
