"""An external node: each answer counted once, each fault by its name; what its processes used."""

from __future__ import annotations

import subprocess
import sys
import time

import psutil
import pytest

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.metrics.score import FindingKind
from sfr_loc_map.pipeline.external_run import MAX_IN_A_ROW, Answer, AnswerBook, ProcessWatch, processes_named

ANSWER = "odom -> base"


class Book(AnswerBook):
    """Answers to some pairs of stamps from 0 on, under a clock that is set by hand."""

    def __init__(self, pairs: int) -> None:
        self.now_s = 100.0
        super().__init__("loc", 1.0, "", lambda: self.now_s)
        for stamp_ns in range(pairs):
            self.published(stamp_ns, self.now_s)

    @property
    def kinds(self) -> list[FindingKind]:
        return [item.kind for item in self.findings]


def test_each_kind_of_answer_is_counted_and_used_or_not() -> None:
    book = Book(4)
    book.now_s += 0.25
    assert book.received(Answer(0, ANSWER))
    assert book.received(Answer(0, ANSWER))
    assert book.received(Answer(77, ANSWER))  # of no pair: it counts by interpolation
    assert not book.received(Answer(1, "odom -> imu"))
    assert not book.received(Answer(1, ANSWER, "a number is not finite"))
    book.now_s += 1.0
    assert book.received(Answer(2, ANSWER))
    counts, latency_s, missing = book.counts, book.latency_s, book.findings[-1]
    assert (counts.pairs, counts.answered, counts.missing) == (4, 2, 2)
    assert (counts.doubled, counts.other_stamp, counts.other_frame, counts.not_usable, counts.late) == (1, 1, 1, 1, 1)
    assert (latency_s.count, latency_s.mean, latency_s.max) == (2, 0.75, 1.25)
    kind = FindingKind
    expected = {kind.DOUBLED, kind.WRONG_STAMP, kind.OTHER_FRAME, kind.NOT_FINITE, kind.LATE, kind.MISSING}
    assert set(book.kinds) == expected
    assert (missing.kind, missing.count, missing.first_stamp_ns) == (kind.MISSING, 2, 1)


def test_a_node_that_does_not_answer_is_given_up_until_it_answers_or_has_ended() -> None:
    book = Book(MAX_IN_A_ROW + 2)
    for stamp_ns in range(MAX_IN_A_ROW):
        assert not book.is_settled(stamp_ns + 1)
        book.waited(stamp_ns)
    assert book.is_settled(MAX_IN_A_ROW)
    assert book.kinds == [FindingKind.HANGING]
    assert book.received(Answer(3, ""))
    assert not book.is_settled(MAX_IN_A_ROW)
    book.node_ended("was killed by SIGSEGV")
    assert book.is_settled(MAX_IN_A_ROW)
    assert book.kinds == [FindingKind.CRASHED, FindingKind.MISSING]


SIZE = 60_000_000
CHILD = f"import sys; data = bytearray({SIZE}); data[::4096] = bytes(len(data[::4096])); print('there', flush=True); "
CHILD += "n = sum(range(3_000_000)); sys.stdin.read()"
PARENT = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {CHILD!r}, 'a-mark-of-its-own'])"


def test_a_child_is_counted_with_its_parent_and_a_name_finds_it() -> None:
    with subprocess.Popen([sys.executable, "-c", PARENT], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as parent:
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
    assert usage.processes == 2
    assert SIZE < usage.peak_rss_bytes < SIZE + 100_000_000
    assert 0.01 < usage.cpu_s < 30.0
