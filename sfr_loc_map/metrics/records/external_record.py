"""The parts `external` and `convention` of the score: how an external node behaved, how poses were converted."""

from __future__ import annotations

from dataclasses import dataclass

from sfr_loc_map.metrics.records.call_records import StageTime


@dataclass(frozen=True, slots=True, kw_only=True)
class AnswerCounts:
    """What became of the pairs that were published to an external node, and of what it published.

    Attributes:
        pairs: Pairs published to it.
        answered: Pairs with a usable answer of their stamp.
        missing: Pairs without one.
        late: Answers that came after their time to answer.
        doubled: Answers of a stamp that had been answered.
        other_stamp: Answers whose stamp is that of no pair; poses among them count by interpolation.
        other_frame: Answers left out because they name other frames.
        not_usable: Answers left out because they are none: numbers that are not finite, no unit quaternion, a cloud
            without x, y, z.
    """

    pairs: int = 0
    answered: int = 0
    missing: int = 0
    late: int = 0
    doubled: int = 0
    other_stamp: int = 0
    other_frame: int = 0
    not_usable: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class ProcessUsage:
    """What the processes of an external node took, seen from outside.

    Attributes:
        cpu_s: Processor time of all of them, user and system, s.
        peak_rss_bytes: Largest sum of their resident memory.
        processes: Largest number of them.
        method: How it was measured.
    """

    cpu_s: float
    peak_rss_bytes: int
    processes: int
    method: str


@dataclass(frozen=True, slots=True, kw_only=True)
class ExternalScore:
    """How an external node behaved.

    Attributes:
        task: `localisation` or `mapping`.
        topic: What it published on.
        frames: Frames that its answers name: `parent` or `parent -> child`.
        answers: What became of pairs and answers.
        latency_s: From publishing the last image of a pair to the receipt of its answer: transport, waiting and
            processing together. It is not a time per call. None without an answer.
        process: CPU and memory of its processes, None where they were not watched.
        ended: How its process ended during the run; empty where it ran on, or was not started here.
    """

    task: str
    topic: str
    frames: str
    answers: AnswerCounts
    latency_s: StageTime | None
    process: ProcessUsage | None = None
    ended: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class ConventionRecord:
    """How the poses were converted before they were scored.

    Attributes:
        declared: Settings that the user gave, `NAME=VALUE`.
        diagnosed: Setting that the diagnosis found and the user had applied; None without.
        fitted: Whether numbers of it were fitted to the truth, which flatters the figures.
        sentence: What the diagnosis says is wrong; None without.
    """

    declared: tuple[str, ...] = ()
    diagnosed: str | None = None
    fitted: bool = False
    sentence: str | None = None
