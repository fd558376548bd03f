"""Record the answers of an external node to the pairs of a replay."""

from __future__ import annotations

import math
import time
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from sfr_loc_map.calls.call_findings import FindingCounts
from sfr_loc_map.metrics.figures.records import AnswerCounts, CallFinding, FindingKind, FindingRecord
from sfr_loc_map.metrics.formulas import Statistics, statistics
from sfr_loc_map.stamp_pairing import STAMP_TOLERANCE_S

MAX_EARLY = 64  #: Maximum number of answers that wait for their pair; the oldest are dropped.
MAX_IN_A_ROW = 10
"""Number of consecutive pairs without an answer after which the replay stops waiting until the node answers."""
EARLY_S = 2.0 * STAMP_TOLERANCE_S
"""Maximum lead of an answer over the last image of its pair, s. An earlier answer was computed without that image. The
images of a pair may be published `STAMP_TOLERANCE_S` apart, and a node that uses one image may answer between them."""
UNUSABLE = (FindingKind.NOT_FINITE, FindingKind.INVALID_RESULT)  #: Kinds of findings on unusable answers.

Content = TypeVar("Content")


class Answer(NamedTuple, Generic[Content]):
    """A usable answer of the node."""

    frames: str  #: Frame ids: `parent -> child` of a pose, `parent` of a cloud.
    received_s: float  #: Time of the monotonic clock when the answer was received.
    content: Content


class AnswerBook(Generic[Content]):
    """Assigns the answers of a run to its pairs, and counts pairs, answers and faults."""

    def __init__(self, timeout_s: float, frames: str | None) -> None:
        """Start without pairs. If `frames` is None, all answers must name the frames of the first used answer."""
        self.frames = frames  #: Required frame ids; None if they are not given and no answer was used.
        self.ended = ""  #: How the node's process ended during the run; empty while the process runs.
        self._timeout_s = timeout_s
        self._sent_s: dict[int, float] = {}  # by stamp: time of the last image of a pair
        self._latency_s: dict[int, float] = {}  # by stamp: latency of the first answer
        self._early: list[tuple[int, Answer[Content]]] = []  # stamp and answer, the oldest first
        self._dropped = 0  # number of dropped early answers
        self._first_dropped_ns: int | None = None
        self._unanswered_in_a_row = 0
        self._faults = FindingCounts()  # answers with a fault
        self._crash: FindingRecord | None = None

    def note_sent(self, stamp_ns: int, sent_s: float) -> Content | None:
        """Record a pair and the time of the monotonic clock when its last image was published, s.

        Return the content of the early answer if it is used; None otherwise.
        """
        self._sent_s[stamp_ns] = sent_s
        early = [answer for early_ns, answer in self._early if early_ns == stamp_ns]
        self._early = [(early_ns, answer) for early_ns, answer in self._early if early_ns != stamp_ns]
        used = None
        for answer in early:
            content = self._assign(stamp_ns, answer)
            if content is not None:
                used = content
        return used

    def note_answer(self, stamp_ns: int, frames: str, problem: CallFinding | None, content: Content) -> Content | None:
        """Note an answer; return its content if it is used, None otherwise. Only the first answer to a pair is used.

        An answer whose stamp is not that of a published pair is kept: `note_sent` returns its content once a pair with
        this stamp is published. If more than `MAX_EARLY` answers are kept, the oldest is dropped. The first used answer
        determines the frames that all other answers must have, unless the constructor received them.

        `frames` are `parent -> child` of a pose, `parent` of a cloud. `problem` is why the answer is unusable; None if
        the answer is usable.
        """
        answer = Answer(frames, time.monotonic(), content)
        if problem is not None:
            self._faults.add(problem.kind, stamp_ns, problem.text)
            return None
        if stamp_ns in self._sent_s:
            return self._assign(stamp_ns, answer)
        # the stamp of no pair, or of a pair whose last image is not published yet
        if self._has_required_frames(answer):
            self._early.append((stamp_ns, answer))
        else:
            self._count_other_frames(stamp_ns, answer)
        if len(self._early) > MAX_EARLY:
            oldest_ns, _ = self._early.pop(0)
            self._dropped += 1
            if self._first_dropped_ns is None:
                self._first_dropped_ns = oldest_ns
        return None

    def note_restart(self, how: str) -> None:
        """Record that the node ended during the run, although a restarted process answers in its place.

        The replay continues to wait for answers, unlike after `note_end`.
        """
        if self._crash is None:
            self._crash = self._crash_at_last_pair(how)

    def note_end(self, how: str) -> None:
        """Record that the node's process has ended during the run."""
        if not self.ended:
            self.ended = how
            self._crash = self._crash_at_last_pair(how)

    def is_settled(self, stamp_ns: int) -> bool:
        """Return whether a pair is answered, or its answer is no longer awaited."""
        if stamp_ns in self._latency_s or self.ended or self._is_given_up:
            return True
        return time.monotonic() - self._sent_s.get(stamp_ns, 0.0) > self._timeout_s

    def note_waited(self, stamp_ns: int) -> None:
        """Record that the wait for a pair is over."""
        if stamp_ns not in self._latency_s:
            self._unanswered_in_a_row += 1

    @property
    def counts(self) -> AnswerCounts:
        """The counts; pairs without an answer in time are missing."""
        missing = len(self._missing_ns)
        return AnswerCounts(
            pairs=len(self._sent_s),
            answered=len(self._sent_s) - missing,
            missing=missing,
            early=self._faults.count(FindingKind.EARLY),
            late=self._faults.count(FindingKind.LATE),
            doubled=self._faults.count(FindingKind.DOUBLED),
            other_stamp=self._unassigned,
            other_frame=self._faults.count(FindingKind.OTHER_FRAME),
            not_usable=sum(self._faults.count(kind) for kind in UNUSABLE),
        )

    @property
    def findings(self) -> tuple[FindingRecord, ...]:
        """One finding for each kind of fault."""
        found = [] if self._crash is None else [self._crash]
        found += self._faults.records
        if count := self._unassigned:
            first_ns = self._early[0][0] if self._first_dropped_ns is None else self._first_dropped_ns
            kind = FindingKind.WRONG_STAMP
            text = "no pair has this stamp"
            found.append(FindingRecord(kind=kind, count=count, first_stamp_ns=first_ns, text=text))
        if missing_ns := self._missing_ns:
            text = f"no answer within {self._timeout_s:g} s"
            if self._is_given_up:
                text += ", and the replay stopped waiting"
            kind = FindingKind.HANGING if self._is_given_up and not self.ended else FindingKind.MISSING
            found.append(FindingRecord(kind=kind, count=len(missing_ns), first_stamp_ns=missing_ns[0], text=text))
        return tuple(found)

    @property
    def latency_s(self) -> Statistics | None:
        """Times from publishing a pair to receiving its answer, negative for early answers; None without answers."""
        return statistics(np.array(list(self._latency_s.values()))) if self._latency_s else None

    @property
    def _is_given_up(self) -> bool:
        """Whether the replay no longer waits for answers, because too many pairs in a row had none."""
        return self._unanswered_in_a_row >= MAX_IN_A_ROW

    @property
    def _missing_ns(self) -> list[int]:
        """Stamps of the pairs that were not answered within the timeout."""
        return [stamp_ns for stamp_ns in self._sent_s if self._latency_s.get(stamp_ns, math.inf) > self._timeout_s]

    def _crash_at_last_pair(self, how: str) -> FindingRecord:
        """Return the finding of a crash, at the last pair that was sent."""
        last_ns = next(reversed(self._sent_s), None)
        return FindingRecord(kind=FindingKind.CRASHED, count=1, first_stamp_ns=last_ns, text=how)

    @property
    def _unassigned(self) -> int:
        """Number of the answers to no pair."""
        return self._dropped + len(self._early)

    def _has_required_frames(self, answer: Answer[Content]) -> bool:
        """Return whether an answer has the required frames, or whether these are unknown."""
        return self.frames in (None, answer.frames)

    def _count_other_frames(self, stamp_ns: int, answer: Answer[Content]) -> None:
        text = f"frames '{answer.frames}' instead of '{self.frames}'"
        self._faults.add(FindingKind.OTHER_FRAME, stamp_ns, text)

    def _assign(self, stamp_ns: int, answer: Answer[Content]) -> Content | None:
        """Assign an answer to its published pair, and count its faults; return its content if the answer is used."""
        if not self._has_required_frames(answer):
            self._count_other_frames(stamp_ns, answer)
            return None
        if stamp_ns in self._latency_s:
            self._faults.add(FindingKind.DOUBLED, stamp_ns, "the pair was answered already")
            return None
        self._unanswered_in_a_row = 0
        latency_s = answer.received_s - self._sent_s[stamp_ns]
        self._latency_s[stamp_ns] = latency_s
        if latency_s < -EARLY_S:
            self._faults.add(FindingKind.EARLY, stamp_ns, f"{-latency_s:.3g} s before the pair was published")
        if latency_s > self._timeout_s:
            self._faults.add(FindingKind.LATE, stamp_ns, f"{latency_s:.3g} s after the pair was published")
            return None
        self.frames = answer.frames
        return answer.content
