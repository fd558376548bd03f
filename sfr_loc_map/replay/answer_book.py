"""Record the answers of an external node to the pairs of a replay."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import numpy as np
from msgspec.structs import replace

from sfr_loc_map.metrics.formulas import Statistics, statistics
from sfr_loc_map.metrics.table.records import AnswerCounts, FindingKind, FindingRecord
from sfr_loc_map.stamp_pairing import STAMP_TOLERANCE_S

MAX_EARLY = 64  #: Maximum number of stamps whose answers wait for their pair; the oldest are dropped.
MAX_IN_A_ROW = 10
"""Number of consecutive pairs without an answer after which the replay stops waiting until the node answers."""
EARLY_S = 2.0 * STAMP_TOLERANCE_S
"""Maximum lead of an answer over the last image of its pair, s. An earlier answer was computed without that image. The
images of a pair may be published `STAMP_TOLERANCE_S` apart, and a node that uses one image may answer between them."""


Content = TypeVar("Content")


@dataclass(slots=True)
class EarlyAnswers(Generic[Content]):
    """Answers to a stamp of which no pair is published yet."""

    content: Content  #: Content of the first answer.
    received_s: list[float] = field(default_factory=list)  #: Times of the monotonic clock.


class AnswerBook(Generic[Content]):
    """Counts the pairs and answers of a run, and keeps the content of answers that arrive before their pair."""

    def __init__(self, timeout_s: float, frames: str) -> None:
        """Start without pairs. Without `frames`, all answers must name the frames of the first answer."""
        self.frames = frames
        self.ended = ""  #: How the node's process ended during the run; empty while the process runs.
        self._timeout_s = timeout_s
        self._sent: dict[int, float] = {}
        self._latency_s: dict[int, float] = {}
        self._early: dict[int, EarlyAnswers[Content]] = {}  # by stamp, the oldest stamp first
        self._dropped = 0  # early answers
        self._first_dropped_ns: int | None = None
        self._unanswered_in_a_row = 0
        self._findings: dict[FindingKind, FindingRecord] = {}

    def note_sent(self, stamp_ns: int, sent_s: float) -> Content | None:
        """Record a pair and the time of the monotonic clock when its last image was published, s.

        Return the content of the early answer if it is used; None otherwise.
        """
        self._sent[stamp_ns] = sent_s
        early = self._early.pop(stamp_ns, None)
        if early is None:
            return None
        is_used = [self._answered(stamp_ns, received_s) for received_s in early.received_s]
        return early.content if is_used[0] else None

    def note_answer(self, stamp_ns: int, frames: str, problem: str, content: Content) -> Content | None:
        """Note an answer; return its content if it is used, None otherwise. Only the first answer to a pair is used.

        An answer to a stamp that is not of a published pair is kept with its content, which `note_sent` returns once a
        pair of this stamp is published. The oldest such answers are dropped.

        `frames` are `parent -> child` of a pose, `parent` of a cloud. `problem` is why the answer is unusable; empty if
        the answer is usable.
        """
        now_s = time.monotonic()
        if problem:
            self._note(FindingKind.NOT_FINITE, stamp_ns, problem)
            return None
        self.frames = self.frames or frames
        if frames != self.frames:
            self._note(FindingKind.OTHER_FRAME, stamp_ns, f"frames {frames} instead of {self.frames}")
            return None
        if stamp_ns in self._sent:
            return content if self._answered(stamp_ns, now_s) else None
        # the stamp of no pair, or of a pair whose last image is not published yet
        self._early.setdefault(stamp_ns, EarlyAnswers(content)).received_s.append(now_s)
        if len(self._early) > MAX_EARLY:
            oldest_ns = next(iter(self._early))
            self._dropped += len(self._early.pop(oldest_ns).received_s)
            self._first_dropped_ns = oldest_ns if self._first_dropped_ns is None else self._first_dropped_ns
        return None

    def note_restart(self, how: str) -> None:
        """Record that the node ended during the run, although a restarted process answers in its place.

        The replay continues to wait for answers, unlike after `note_end`.
        """
        self._findings.setdefault(FindingKind.CRASHED, self._crash(how))

    def note_end(self, how: str) -> None:
        """Record that the node's process has ended during the run."""
        if not self.ended:
            self.ended = how
            self._findings[FindingKind.CRASHED] = self._crash(how)

    def is_settled(self, stamp_ns: int) -> bool:
        """Return whether a pair is answered, or its answer is no longer awaited."""
        if stamp_ns in self._latency_s or self.ended or self._unanswered_in_a_row >= MAX_IN_A_ROW:
            return True
        return time.monotonic() - self._sent.get(stamp_ns, 0.0) > self._timeout_s

    def note_waited(self, stamp_ns: int) -> None:
        """Record that the wait for a pair is over."""
        if stamp_ns not in self._latency_s:
            self._unanswered_in_a_row += 1

    @property
    def counts(self) -> AnswerCounts:
        """The counts; pairs without an answer in time are missing."""
        answered = len(self._in_time)
        return AnswerCounts(
            pairs=len(self._sent),
            answered=answered,
            missing=len(self._sent) - answered,
            early=self._count(FindingKind.EARLY),
            late=self._count(FindingKind.LATE),
            doubled=self._count(FindingKind.DOUBLED),
            other_stamp=self._dropped + sum(len(early.received_s) for early in self._early.values()),
            other_frame=self._count(FindingKind.OTHER_FRAME),
            not_usable=self._count(FindingKind.NOT_FINITE),
        )

    @property
    def _in_time(self) -> set[int]:
        """Stamps of the pairs that were answered within the timeout."""
        return {stamp_ns for stamp_ns, latency_s in self._latency_s.items() if latency_s <= self._timeout_s}

    @property
    def findings(self) -> tuple[FindingRecord, ...]:
        """One finding for each kind of fault."""
        in_time = self._in_time
        missing = [stamp_ns for stamp_ns in self._sent if stamp_ns not in in_time]
        found = list(self._findings.values())
        if count := self.counts.other_stamp:
            first = next(iter(self._early)) if self._first_dropped_ns is None else self._first_dropped_ns
            kind, text = FindingKind.WRONG_STAMP, "no pair has this stamp"
            found.append(FindingRecord(kind=kind, count=count, first_stamp_ns=first, text=text))
        if missing:
            given_up = self._unanswered_in_a_row >= MAX_IN_A_ROW
            text = f"no answer within {self._timeout_s:g} s" + (", and the replay stopped waiting" if given_up else "")
            kind = FindingKind.HANGING if given_up and not self.ended else FindingKind.MISSING
            found.append(FindingRecord(kind=kind, count=len(missing), first_stamp_ns=missing[0], text=text))
        return tuple(found)

    @property
    def latency_s(self) -> Statistics | None:
        """Times from publishing a pair to receiving its answer, negative for early answers; None without answers."""
        return statistics(np.array(list(self._latency_s.values()))) if self._latency_s else None

    def _crash(self, how: str) -> FindingRecord:
        """Return the finding of a crash, at the last pair that was sent."""
        last = max(self._sent, default=None)
        return FindingRecord(kind=FindingKind.CRASHED, count=1, first_stamp_ns=last, text=how)

    def _answered(self, stamp_ns: int, received_s: float) -> bool:
        """Record the answer to a published pair; return whether the answer is used."""
        if stamp_ns in self._latency_s:
            self._note(FindingKind.DOUBLED, stamp_ns, "the pair was answered already")
            return False
        self._unanswered_in_a_row = 0
        latency_s = received_s - self._sent[stamp_ns]
        self._latency_s[stamp_ns] = latency_s
        if latency_s < -EARLY_S:
            self._note(FindingKind.EARLY, stamp_ns, f"{-latency_s:.3g} s before the pair was published")
        is_late = latency_s > self._timeout_s
        if is_late:
            self._note(FindingKind.LATE, stamp_ns, f"{latency_s:.3g} s after the pair was published")
        return not is_late

    def _note(self, kind: FindingKind, stamp_ns: int, text: str) -> None:
        """Count an answer with a fault; stamp and text of the first answer are kept."""
        before = self._findings.get(kind) or FindingRecord(kind=kind, count=0, first_stamp_ns=stamp_ns, text=text)
        self._findings[kind] = replace(before, count=before.count + 1)

    def _count(self, kind: FindingKind) -> int:
        """Return the number of answers with a fault."""
        return self._findings[kind].count if kind in self._findings else 0
