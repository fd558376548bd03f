"""An external node in a replay: what it answered, what its process used, its poses converted. Knows nothing of ROS."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import psutil

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.localisation.estimate import TrackingState
from sfr_loc_map.metrics.association import UPPER, Estimates, lost_by_covariance
from sfr_loc_map.metrics.calls import stage_time
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.metrics.convention import converted_estimates
from sfr_loc_map.metrics.score import (
    AnswerCounts,
    ConventionRecord,
    ExternalScore,
    FindingKind,
    FindingRecord,
    MethodRecord,
    ProcessUsage,
    StageTime,
)
from sfr_loc_map.pipeline.call_stats import CallRecord
from sfr_loc_map.pipeline.scoring import Correction, ScoredDrive, corrected

MAX_IN_A_ROW = 10
"""After so many pairs in a row without an answer the node is not waited for any more, until it answers."""


@dataclass(frozen=True, slots=True)
class Answer:
    """What a node published: stamp, the frames that it names, and whether it can be used.

    Attributes:
        stamp_ns: Stamp of its header.
        frames: `parent -> child` of a pose, `parent` of a cloud.
        problem: Why it is no pose or no cloud; empty for one.
    """

    stamp_ns: int
    frames: str
    problem: str = ""


class AnswerBook:
    """Counts pairs and answers of one run."""

    def __init__(
        self, task: str, timeout_s: float, frames: str = "", clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Begin.

        Args:
            task: Rig of the pairs: `loc` or `nav`.
            timeout_s: An answer that comes later is late.
            frames: What the answers name; empty: what the first of them names.
            clock: Monotonic seconds.
        """
        self.task, self.frames = task, frames
        self._timeout_s, self._clock = timeout_s, clock
        self._sent: dict[int, float] = {}
        self._latency_s: dict[int, float] = {}
        self._early: dict[int, list[float]] = {}
        self._counts = AnswerCounts()
        self._in_a_row = 0
        self._findings: dict[FindingKind, FindingRecord] = {}
        self.ended = ""

    def published(self, stamp_ns: int, sent_s: float) -> None:
        """Note a pair whose last image was published at a time of the clock."""
        self._sent[stamp_ns] = sent_s
        for received_s in self._early.pop(stamp_ns, ()):
            self._answered(stamp_ns, received_s)

    def received(self, answer: Answer) -> bool:
        """Note an answer; return whether it is to be used."""
        now, stamp_ns = self._clock(), answer.stamp_ns
        if answer.problem:
            self._note("not_usable", FindingKind.NOT_FINITE, stamp_ns, answer.problem)
            return False
        self.frames = self.frames or answer.frames
        if answer.frames != self.frames:
            text = f"it names {answer.frames} in place of {self.frames}"
            self._note("other_frame", FindingKind.OTHER_FRAME, stamp_ns, text)
            return False
        self._in_a_row = 0
        if stamp_ns in self._sent:
            self._answered(stamp_ns, now)
        else:  # of no pair; or of one whose last image is still to be published
            self._early.setdefault(stamp_ns, []).append(now)
        return True

    def _answered(self, stamp_ns: int, received_s: float) -> None:
        if stamp_ns in self._latency_s:
            self._note("doubled", FindingKind.DOUBLED, stamp_ns, "the pair had its answer")
            return
        self._latency_s[stamp_ns] = latency = max(received_s - self._sent[stamp_ns], 0.0)
        if latency > self._timeout_s:
            text = f"{latency:.3g} s after the pair was published"
            self._note("late", FindingKind.LATE, stamp_ns, text)

    def node_ended(self, how: str) -> None:
        """Note that the node's process has ended during the run."""
        if not self.ended:
            self.ended = how
            last = max(self._sent, default=None)
            self._findings[FindingKind.CRASHED] = FindingRecord(
                kind=FindingKind.CRASHED, count=1, first_stamp_ns=last, text=how
            )

    def is_settled(self, stamp_ns: int) -> bool:
        """Tell whether the answer to a pair is there, or need not be waited for any longer."""
        if stamp_ns in self._latency_s or self.ended or self._in_a_row >= MAX_IN_A_ROW:
            return True
        return self._clock() - self._sent.get(stamp_ns, 0.0) > self._timeout_s

    def waited(self, stamp_ns: int) -> None:
        """Note that a pair was waited for until it was settled."""
        if stamp_ns not in self._latency_s:
            self._in_a_row += 1

    @property
    def counts(self) -> AnswerCounts:
        """The counts, with pairs that have no answer as missing."""
        pairs, answered = len(self._sent), len(self._latency_s)
        other = sum(map(len, self._early.values()))
        return replace(self._counts, pairs=pairs, answered=answered, missing=pairs - answered, other_stamp=other)

    @property
    def findings(self) -> tuple[FindingRecord, ...]:
        """What was wrong, one for each kind."""
        missing = [stamp_ns for stamp_ns in self._sent if stamp_ns not in self._latency_s]
        found = list(self._findings.values())
        if self._early:
            first, count = next(iter(self._early)), self.counts.other_stamp
            kind, text = FindingKind.WRONG_STAMP, "it is the stamp of no pair"
            found.append(FindingRecord(kind=kind, count=count, first_stamp_ns=first, text=text))
        if missing:
            text = f"no answer within {self._timeout_s:g} s" + (", not waited for at last" if self._given_up else "")
            kind = FindingKind.HANGING if self._given_up and not self.ended else FindingKind.MISSING
            found.append(FindingRecord(kind=kind, count=len(missing), first_stamp_ns=missing[0], text=text))
        return tuple(found)

    @property
    def latency_s(self) -> StageTime | None:
        """Times from publishing a pair to the receipt of its answer; None without an answer."""
        return stage_time(np.array(list(self._latency_s.values())))

    @property
    def _given_up(self) -> bool:
        return self._in_a_row >= MAX_IN_A_ROW

    def _note(self, count: str, kind: FindingKind, stamp_ns: int, text: str) -> None:
        self._counts = replace(self._counts, **{count: getattr(self._counts, count) + 1})
        before = self._findings.get(kind) or FindingRecord(kind=kind, count=0, first_stamp_ns=stamp_ns, text=text)
        self._findings[kind] = replace(before, count=before.count + 1)


PERIOD_S = 0.05
METHOD = f"sum over the process tree, sampled {1 / PERIOD_S:.0f} times a second (psutil)"


def processes_named(text: str) -> list[int]:
    """Return the process ids that `--watch` means: one by its number, or all whose name or command line has the text.

    Raises:
        ConfigError: If there is none.
    """
    if text.isdigit():
        found = [int(text)] if psutil.pid_exists(int(text)) else []
    else:
        found = [process.pid for process in psutil.process_iter() if _is_named(process, text)]
    if not found:
        raise ConfigError(f"'--watch {text}': there is no such process; give its number or a part of its command line")
    return found


def _is_named(process: psutil.Process, text: str) -> bool:
    with contextlib.suppress(psutil.Error):
        words = process.cmdline()
        return "--watch" not in words and (text == process.name() or text in " ".join(words))
    return False


class ProcessWatch:
    """Samples processes and their descendants in a thread of its own.

    A process that ends keeps the processor time of its last sample. A peak between two samples is missed.
    """

    def __init__(self, pids: Sequence[int], period_s: float = PERIOD_S) -> None:
        """Watch nothing yet.

        Args:
            pids: Roots of the trees.
            period_s: Time between samples.
        """
        self._pids, self._period_s = list(pids), period_s
        self._cpu_s: dict[tuple[int, float], float] = {}
        self._begin_s: dict[tuple[int, float], float] = {}
        self._peak_bytes, self._most = 0, 0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="process-watch", daemon=True)

    def start(self) -> None:
        """Begin to sample."""
        self._sample(first=True)
        self._thread.start()

    def stop(self) -> None:
        """Take the last sample; once is enough."""
        if not self._stop.is_set():
            self._stop.set()
            self._thread.join()
            self._sample()

    @property
    def usage(self) -> ProcessUsage | None:
        """What was used since the watch began; None if nothing could be seen."""
        if not self._most:
            return None
        spent = sum(self._cpu_s[key] - self._begin_s[key] for key in self._cpu_s)
        return ProcessUsage(cpu_s=spent, peak_rss_bytes=self._peak_bytes, processes=self._most, method=METHOD)

    def _run(self) -> None:
        while not self._stop.wait(self._period_s):
            self._sample()

    def _sample(self, *, first: bool = False) -> None:
        resident = seen = 0
        for process in self._tree():
            with contextlib.suppress(psutil.Error):
                key = (process.pid, process.create_time())
                times = process.cpu_times()
                resident += process.memory_info().rss
                self._cpu_s[key] = times.user + times.system
                self._begin_s.setdefault(key, self._cpu_s[key] if first else 0.0)
                seen += 1
        self._peak_bytes, self._most = max(self._peak_bytes, resident), max(self._most, seen)

    def _tree(self) -> list[psutil.Process]:
        found: dict[int, psutil.Process] = {}
        for pid in self._pids:
            with contextlib.suppress(psutil.Error):
                root = psutil.Process(pid)
                found |= {process.pid: process for process in (root, *root.children(recursive=True))}
        return list(found.values())


@dataclass(frozen=True, slots=True, eq=False)
class ExternalRun:
    """What is known of an external node after a replay.

    Attributes:
        method: Its name and version.
        score: How it behaved.
        findings: What was wrong with its answers.
        correction: How its poses are converted.
        log: What its process wrote; empty where it was not started here.
        as_published: Its poses as it published them.
        convention: How they have been converted; None where they have not.
    """

    method: MethodRecord
    score: ExternalScore
    findings: tuple[FindingRecord, ...]
    correction: Correction
    log: str = ""
    as_published: Trajectory | None = None
    convention: ConventionRecord | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """What the source knows of a drive.

    Attributes:
        rig: The stereo rig, None where it is not known.
        truth: True poses, None where it has none.
    """

    rig: StereoRig | None
    truth: Trajectory | None


def converted_run(
    estimate: Trajectory, records: Sequence[CallRecord], run: ExternalRun, drive: Drive, config: ScoreConfig
) -> tuple[Trajectory, list[CallRecord], ExternalRun]:
    """Return the poses of an external localiser as poses of RB in DS, a record for each, and what was done.

    Args:
        estimate: Poses as published.
        records: What the node told of its calls, with the covariances of its poses; those of mapping stay as they are.
        run: What is known of it.
        drive: What the source knows.
        config: Settings of the diagnosis.

    Raises:
        ConfigError: If a frame is declared that the rig does not tell.
        MetricsError: If the world frame cannot be aligned.
    """
    if not len(estimate):
        return estimate, list(records), run
    told = {item.stamp_ns: item for item in records if item.state in set(TrackingState)}
    covariance = np.full((len(estimate), len(UPPER[0])), np.nan)
    for row, stamp_ns in enumerate(estimate.stamps_ns.tolist()):
        known = told.get(stamp_ns)
        if known is not None and known.covariance is not None:
            covariance[row] = known.covariance[UPPER]
    lost = lost_by_covariance(covariance)
    given = Estimates.of(estimate, lost, covariance=None if np.isnan(covariance).all() else covariance)
    found, convention = _converted(given, run.correction, drive, config)
    rows = [
        _record(
            told.get(before), stamp_ns, bool(lost[row]), None if found.covariance is None else found.covariance[row]
        )
        for row, (before, stamp_ns) in enumerate(
            zip(estimate.stamps_ns.tolist(), found.trajectory.stamps_ns.tolist(), strict=True)
        )
    ]
    others = [item for item in records if item.state not in set(TrackingState)]
    return found.trajectory, [*rows, *others], replace(run, as_published=estimate, convention=convention)


def _converted(
    given: Estimates, correction: Correction, drive: Drive, config: ScoreConfig
) -> tuple[Estimates, ConventionRecord | None]:
    if drive.truth is not None and len(drive.truth):
        scored, convention = corrected(ScoredDrive(given, drive.truth, drive.rig), correction, config)
        return scored.estimates, convention
    declared = correction.declared
    if not declared.settings:
        return given, None
    found = converted_estimates(given, declared, declared.T_rb_child(drive.rig), None)
    return found, ConventionRecord(declared=declared.settings)


def _record(told: CallRecord | None, stamp_ns: int, lost: bool, covariance: Any) -> CallRecord:  # noqa: ANN401
    """Return the record of one pose; its time is NaN where the node told none."""
    record = told or CallRecord(stamp_ns, float("nan"), TrackingState.TRACKING, None, None)
    full = None
    if covariance is not None and np.isfinite(covariance).all():
        full = np.zeros((6, 6))
        full[UPPER] = full[UPPER[1], UPPER[0]] = covariance
    state = TrackingState.LOST.value if lost else record.state
    return replace(record, stamp_ns=stamp_ns, state=state, covariance=full, step=None)
