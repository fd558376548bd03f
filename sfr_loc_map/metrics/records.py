"""Records of a score that are not figures: how estimates were compared, the item under test, and the inputs."""

from __future__ import annotations

from enum import StrEnum
from typing import Any

import msgspec

from sfr_loc_map.metrics.config import SPACING_FRAMES, AssociationMode, CloudKind, Rebase
from sfr_loc_map.metrics.formulas import Statistics


class Record(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, forbid_unknown_fields=True):
    """Base of everything that is written as JSON: frozen structs, whose types are checked when they are read."""


# ---- how estimates were compared with the ground truth


class Association(Record, frozen=True, kw_only=True, omit_defaults=False):
    """How estimates found their ground truth, and what became of the poses."""

    matched: int  #: Frames: poses of the ground truth that have an estimate.
    estimate_poses: int  #: Estimates given.
    truth_poses: int  #: True poses given.
    images: int | None = None  #: Images of the drive; null where they are unknown.
    lost: int = 0  #: Frames at which the localiser was lost; they count like any other.
    degraded: int = 0  #: Frames whose pose was reported as degraded; they count like any other.
    exact: int = 0  #: Frames whose stamps are equal.
    near: int = 0  #: Frames whose stamps differ within the tolerance.
    interpolated: int = 0  #: Frames with interpolated ground truth.
    estimate_duplicates: int = 0  #: Estimates ignored because a later one has the same stamp.
    truth_duplicates: int = 0  #: True poses ignored because a later one has the same stamp.
    estimate_unordered: int = 0  #: Estimates that came after one with a later stamp (sorted, not ignored).
    truth_unordered: int = 0  #: True poses that came after one with a later stamp.
    largest_difference_ns: int = 0  #: Largest difference of the two stamps of a frame.
    largest_gap_ns: int = 0  #: Largest gap of the ground truth that was interpolated.
    path_length_m: float = 0.0  #: Length of the true path over the frames.
    duration_s: float | None = None  #: From the first to the last frame.
    mode: AssociationMode = AssociationMode.MATCH  #: `match` or `interpolate`.
    tolerance_s: float = 0.0  #: Stamps this close are the same.
    max_gap_s: float = 0.0  #: Longest gap of the ground truth that is interpolated.
    spacing_frames: int = SPACING_FRAMES  #: Frames from one start of a sub-trajectory to the next [4.1.1].
    #: How error from before N is removed [4.1.2]: `T_gt(N) inv(T_est(N)) T_est(N+x)` is compared with `T_gt(N+x)`
    #: (pose); displacements in DS, and changes of attitude and heading since N, are compared (displacement); or the
    #: position at N alone is subtracted (position). Where the ground truth has no attitudes, the yaw (yaw_aligned) or
    #: the complete rotation (rotation_aligned) of the estimate is fitted over the drive, then as position.
    rebase: Rebase = Rebase.POSE
    incomplete: str | None = None  #: Why the estimate does not cover the whole drive; null if it does.


class TruthRecord(Record, frozen=True, kw_only=True, omit_defaults=False):
    """What is known of the ground truth."""

    attitude: bool  #: Whether it has attitudes; without them attitude and heading errors are unknown.
    height: bool = True  #: Whether its heights are known; without them position errors are horizontal alone.
    tilt: bool = True  #: Whether its roll and pitch are known; without them attitude errors are unknown.
    sigma_m: float | None = None  #: Standard deviation of its positions along each axis; null: taken as exact.
    sigma_deg: float | None = None  #: Standard deviation of its attitudes about each axis; null: taken as exact.
    path_excess: float | None = None  #: Fraction by which its noise lengthens its path, `2 (sigma / step)^2`.
    lever_arm_m: tuple[float, ...] = ()  #: Point in RB that its positions are of; the estimate was taken there.
    declared: tuple[str, ...] = ()  #: Settings `truth.NAME=VALUE` by which it was read and that change its poses.
    yaw_deg: float | None = None  #: Yaw that was fitted: rotates the estimate.
    tilt_deg: float | None = None  #: Angle by which z was tilted with it; null where only the yaw was fitted.
    translation_m: tuple[float, ...] = ()  #: Translation that was fitted, after the rotation.

    @property
    def is_exact(self) -> bool:
        """Whether all its components are known and taken as exact."""
        is_complete = self.attitude and self.height and self.tilt
        return is_complete and self.sigma_m is None and self.sigma_deg is None


class Alignment(Record, frozen=True, kw_only=True):
    """How APE and RPE were computed."""

    align: str  #: How the estimate was aligned: `none`, `origin`, `se3` or `sim3`.
    association: str  #: How poses of estimate and ground truth were paired.
    max_difference_s: float  #: Longest difference of the stamps of a pair.
    rpe_delta: str  #: Length of a relative error: `frames=1`.
    scale: float = 1.0  #: `p -> scale R p + t` was applied to the estimate.
    quat_xyzw: tuple[float, ...] = (0.0, 0.0, 0.0, 1.0)  #: Rotation R, scalar last.
    translation_m: tuple[float, ...] = (0.0, 0.0, 0.0)  #: t.


class CloudRecord(Record, frozen=True, kw_only=True):
    """How a cloud was compared with the ground truth."""

    kind: CloudKind | None = None  #: Whether it is fused; null where the points' pixels are unknown.
    #: Whether the points' pixels are unknown, so that only distances to the nearest true points are known.
    nearest_only: bool = False
    scored_range_m: tuple[float, float]  #: Ranges [low, high) of the ground truth that count for coverage.


class CallRecords(Record, frozen=True, kw_only=True):
    """How times and memory were measured."""

    clocks: dict[str, str] = {}  #: Clock of the times by kind of call; a host time is never a time of the target.
    memory_method: str | None = None  #: How memory was measured; null if it was not.


# ---- the software under test, and what it did


class TargetRecord(Record, frozen=True, kw_only=True, forbid_unknown_fields=False):
    """What a target reports about itself (`target.json` of the harness); unknown facts are null."""

    candidate: str | None = None  #: Version of the item under test.
    board: str | None = None  #: Board.
    os: str | None = None  #: Operating system.
    clock: str | None = None  #: Clock of the times.
    clock_resolution_s: float | None = None  #: Its resolution.
    compiler: str | None = None  #: Compiler.
    flags: str | None = None  #: Its flags.
    byte_order: str | None = None  #: `big-endian` or `little-endian`.
    pointer_bits: int | None = None  #: Size of an address.


class TargetRun(Record, frozen=True, kw_only=True):
    """Where calls were measured that are not of this host [4.2.1, 4.3.1]; their rows have the part `target`."""

    name: str  #: Name of the target.
    about: TargetRecord | None = None  #: Facts reported by the board; null where it was not a run of the harness.
    matched_share: float | None = None  #: Fraction of estimates that have a call; null where calls have no stamps.
    other_run: str | None = None  #: Which run the calls are of, where it is not the estimate's.
    memory_method: str | None = None  #: How memory was measured; null if it was not.


class MethodKind(StrEnum):
    """How a method under test is reached."""

    BUILT_IN = "built-in"  #: A part of this suite.
    PEER = "peer"  #: Known to this suite, installed by the user in an interpreter of its own.
    PYTHON = "python"  #: A Python class.
    LIBRARY = "library"  #: A C library behind the ABI of `sfr_candidate.h`.
    EXTERNAL = "external"  #: A ROS node that was not started from this suite's code.


class FindingKind(StrEnum):
    """What a method did wrong in a call."""

    CRASHED = "crashed"  #: Its process ended.
    HANGING = "hanging"  #: It did not return in time and was ended.
    OUT_OF_MEMORY = "out of memory"  #: It exceeded the memory that it may have and was ended.
    LEAKING = "leaking"  #: It keeps more memory after every call.
    RAISED = "raised"  #: It raised an error or reported a failure.
    NOT_FINITE = "not finite"  #: A number of its result is NaN or infinite.
    WRONG_STAMP = "wrong stamp"  #: Its result is that of another pair.
    MISSING = "missing answer"  #: An external node did not answer a pair.
    EARLY = "early answer"  #: An external node answered a pair before its last image was published.
    LATE = "late answer"  #: An external node answered after its time to answer.
    DOUBLED = "doubled answer"  #: An external node answered a pair again.
    MISSTATED = "misstated"  #: What it states of its time or memory contradicts what was measured from outside.
    OTHER_FRAME = "another frame"  #: An answer of an external node names other frames.
    INVALID_RESULT = "invalid result"  #: Its result has another type, size or meaning than agreed.

    @property
    def fails(self) -> bool:
        """Whether no score with it can be a pass; pairs without an answer make an estimate incomplete."""
        return self not in (FindingKind.MISSING, FindingKind.LATE, FindingKind.DOUBLED, FindingKind.OTHER_FRAME)


class MethodRecord(Record, frozen=True, kw_only=True):
    """The software that made the estimate or the cloud."""

    name: str  #: Its name.
    version: str | None  #: As the method reports it; null where it does not.
    kind: MethodKind  #: How it is reached.
    sha256: str | None = None  #: Hash of the file that it was loaded from; null where it is not one file.
    #: Hash of the text of its configuration, of our method that of the settings that are not the defaults; null without
    #: one, or where unknown.
    config_sha256: str | None = None
    isolation: str | None = None  #: What its process was kept from; null where that is unknown, or not needed.


class FindingRecord(Record, frozen=True, kw_only=True):
    """Calls of a method with one kind of fault."""

    kind: FindingKind  #: What it did wrong.
    count: int  #: Number of calls.
    first_stamp_ns: int | None  #: Stamp of the first of them.
    text: str  #: What is known of the first, in one line.

    def __str__(self) -> str:
        """Say it in one line."""
        calls = "1 call" if self.count == 1 else f"{self.count} calls, the first"
        place = "" if self.first_stamp_ns is None else f" at stamp {self.first_stamp_ns}"
        return f"{self.kind}: {calls}{place}: {self.text}"


class AnswerCounts(Record, frozen=True, kw_only=True, omit_defaults=False):
    """What became of the pairs that were published to an external node, and of what it published."""

    pairs: int = 0  #: Pairs published to it.
    answered: int = 0  #: Pairs with a usable answer of their stamp within the time to answer.
    missing: int = 0  #: Pairs without such an answer.
    early: int = 0  #: Answers that came before the last image of their pair.
    late: int = 0  #: Answers ignored because they came after their time to answer.
    doubled: int = 0  #: Answers of a stamp that had been answered.
    other_stamp: int = 0  #: Answers whose stamp is that of no pair; poses among them count by interpolation.
    other_frame: int = 0  #: Answers ignored because they name other frames.
    not_usable: int = 0  #: Answers ignored because they are invalid: not finite, no unit quaternion, no x, y, z.


class ProcessUsage(Record, frozen=True, kw_only=True):
    """What the processes of a method took, seen from outside."""

    cpu_s: float  #: Processor time of all of them, user and system, s.
    #: That of it between the calls, and beyond what all threads could do within them; null for an external node.
    cpu_outside_s: float | None = None
    peak_rss_bytes: int  #: Largest sum of their resident memory.
    processes: int  #: Largest number of them.
    threads: int | None = None  #: Largest number of their threads; null for an external node.
    method: str  #: How it was measured.


class ExternalScore(Record, frozen=True, kw_only=True):
    """How an external node behaved."""

    task: str  #: `localisation` or `mapping`.
    topic: str  #: What it published on.
    frames: str  #: Frames that its answers name: `parent` or `parent -> child`.
    answers: AnswerCounts  #: What became of pairs and answers.
    latency_s: Statistics | None  #: From publishing the last image of a pair to its answer: not a time per call.
    process: ProcessUsage | None = None  #: CPU and memory of its processes, null where they were not watched.
    ended: str = ""  #: How its process ended during the run; empty where it ran on, or was not started here.


class ConventionRecord(Record, frozen=True, kw_only=True):
    """How the poses were converted before they were scored."""

    declared: tuple[str, ...] = ()  #: Settings that the user gave, `NAME=VALUE`.
    diagnosed: str | None = None  #: Setting that the diagnosis found and the user had applied; null without.
    fitted: bool = False  #: Whether numbers of it were fitted to the ground truth, which flatters the figures.
    sentence: str | None = None  #: What the diagnosis reports as wrong; null without.


class InputFile(Record, frozen=True, kw_only=True):
    """An input of the score."""

    path: str  #: As given.
    sha256: str  #: Hash of the content.
    data_sha256: str | None = None  #: Of a ground truth the hash of its values, whatever file they were read from.
    read_from: str | None = None  #: Of a ground truth the topic, frame or file that it was read from, where known.


class Provenance(Record, frozen=True, kw_only=True):
    """What the score was made of."""

    version: str  #: Of this suite.
    commit: str | None = None  #: Commit that it was installed from, null where that is unknown.
    command: str | None = None  #: Command that makes the figures again, null where none was given.
    inputs: dict[str, InputFile] = {}  #: Files by role.
    configuration: dict[str, Any] = {}  #: Settings in force.
    host: dict[str, str] = {}  #: Machine, system and Python.
    time: str | None = None  #: When it was made, ISO 8601.
