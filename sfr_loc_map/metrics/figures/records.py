"""Records of a score besides the figures: how estimates were compared, the item under test, and the inputs."""

from __future__ import annotations

import re
from enum import StrEnum
from typing import Any, NamedTuple

import msgspec

from sfr_loc_map.message_text import printable
from sfr_loc_map.metrics.config import SPACING_FRAMES, AssociationMode, CloudKind, Reading
from sfr_loc_map.metrics.formulas import Statistics

REPLAY_RATE = "replay.rate"
"""Setting with the multiple of the recorded speed of a replay; missing in lock step (rate 0)."""


class Record(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, forbid_unknown_fields=True):
    """Base of everything that is written as JSON: frozen structs whose types are checked at reading."""


# ---- how estimates were compared with the ground truth


class Association(Record, frozen=True, kw_only=True, omit_defaults=False):
    """How estimates were associated with the ground truth, and the numbers of poses."""

    matched: int  #: Frames: estimates that have a true pose, measured or interpolated.
    estimate_poses: int  #: Estimates in the input.
    truth_poses: int  #: True poses in the input.
    images: int | None = None  #: Images of the drive; null if they are unknown.
    #: Frames at which the localiser was lost, which are scored like any other; null if a state is unknown.
    lost: int | None = None
    #: Frames whose pose was reported as degraded, which are scored like any other; null if a state is unknown.
    degraded: int | None = None
    exact: int = 0  #: Frames whose estimate and true pose have equal stamps.
    near: int = 0  #: Frames whose estimate and true pose have stamps that differ within the tolerance.
    interpolated: int = 0  #: Frames with interpolated ground truth.
    estimate_duplicates: int = 0  #: Estimates that were ignored because a later estimate has the same stamp.
    truth_duplicates: int = 0  #: True poses that were ignored because a later true pose has the same stamp.
    estimate_unordered: int = 0  #: Estimates after an estimate with a later stamp (sorted, not ignored).
    truth_unordered: int = 0  #: True poses after a true pose with a later stamp (sorted, not ignored).
    largest_difference_ns: int = 0  #: Largest difference of the two stamps of a frame.
    beside_images: int = 0  #: Frames whose estimate has another stamp than its image, by more than 1 ms.
    largest_image_difference_ns: int = 0  #: Largest difference of the stamps of an estimate and its image.
    largest_gap_ns: int = 0  #: Largest gap of the ground truth that was interpolated.
    path_length_m: float = 0.0  #: Length of the true path over the frames.
    duration_s: float | None = None  #: Time from the first to the last frame.
    mode: AssociationMode = AssociationMode.MATCH  #: `match` or `interpolate`.
    tolerance_s: float = 0.0  #: Largest difference between stamps that are considered equal.
    max_gap_s: float = 0.0  #: Longest gap of the ground truth that is interpolated.
    spacing_frames: int = SPACING_FRAMES  #: Frames from one start of a sub-trajectory to the next [4.1.1].
    #: Removal of the error from before N [4.1.2]. `pose` compares `T_gt(N) inv(T_est(N)) T_est(N+x)` with `T_gt(N+x)`.
    #: `displacement` compares displacements in DS, and the changes of attitude and heading since N. `position` removes
    #: only the position at N. If the ground truth has no attitudes, the yaw (`yaw_aligned`) or the complete rotation
    #: (`rotation_aligned`) of the estimate is fitted over the drive, and then `position` is applied.
    reading: Reading = msgspec.field(name="rebase", default=Reading.POSE)


class TruthRecord(Record, frozen=True, kw_only=True, omit_defaults=False):
    """Properties of the ground truth."""

    attitude: bool  #: Whether the attitudes are known; if not, attitude and heading errors are unknown.
    height: bool = True  #: Whether the heights are known; if not, only horizontal position errors are judged.
    tilt: bool = True  #: Whether roll and pitch are known; if not, attitude errors are unknown.
    sigma_m: float | None = None  #: Standard deviation of the positions along each axis; null if assumed exact.
    sigma_deg: float | None = None  #: Standard deviation of the attitudes about each axis; null if assumed exact.
    path_excess: float | None = None  #: Fraction by which noise lengthens the true path, `2 (sigma / step)^2`.
    lever_arm_m: tuple[float, ...] = ()  #: Tracked point in RB; a truth without attitudes is compared at this point.
    declared: tuple[str, ...] = ()  #: Settings `truth.NAME=VALUE` that changed the poses of the truth.
    yaw_deg: float | None = None  #: Fitted yaw, which rotates the estimate; null without a fit.
    tilt_deg: float | None = None  #: Tilt of z by the fitted rotation; null if only the yaw was fitted.
    translation_m: tuple[float, ...] = ()  #: Fitted translation after the rotation.

    @property
    def is_exact(self) -> bool:
        """Whether all components are known and assumed exact."""
        is_complete = self.attitude and self.height and self.tilt
        return is_complete and self.sigma_m is None and self.sigma_deg is None


class Alignment(Record, frozen=True, kw_only=True):
    """How APE and RPE were computed."""

    align: str  #: How the estimate was aligned: `none`, `origin`, `se3` or `sim3`.
    association: str  #: How poses of estimate and ground truth were paired.
    max_difference_s: float  #: Largest difference between the stamps of paired poses.
    rpe_delta: str  #: Length of a relative error, such as `frames=1`.
    scale: float = 1.0  #: `p -> scale R p + t` was applied to the estimate.
    quat_xyzw: tuple[float, ...] = (0.0, 0.0, 0.0, 1.0)  #: Rotation R, scalar last.
    translation_m: tuple[float, ...] = (0.0, 0.0, 0.0)  #: t.


class CloudRecord(Record, frozen=True, kw_only=True):
    """How a cloud was compared with the ground truth."""

    kind: CloudKind | None = None  #: Whether the cloud is fused; null if the pixels of the points are unknown.
    #: Whether the pixels of the points are unknown, so only distances to the nearest true points are known.
    nearest_only: bool = False
    scored_range_m: tuple[float, float]  #: Range [low, high) of the true points in the coverage, m.


class CallRecords(Record, frozen=True, kw_only=True):
    """How times and memory were measured."""

    #: Clock that timed the calls, by kind of call. Times by the clock of the host do not apply to the target.
    clocks: dict[str, str] = {}
    memory_method: str | None = None  #: Method of measuring memory; null if memory was not measured.


# ---- the item under test, and its faults


class TargetRecord(Record, frozen=True, kw_only=True, forbid_unknown_fields=False):
    """Facts that a target reports about itself (`target.json` of the harness); null if unknown."""

    candidate: str | None = None  #: Version of the item under test.
    board: str | None = None  #: Board.
    os: str | None = None  #: Operating system.
    clock: str | None = None  #: Clock that timed the calls.
    clock_resolution_s: float | None = None  #: Resolution of the clock.
    compiler: str | None = None  #: Compiler.
    flags: str | None = None  #: Flags of the compiler.
    byte_order: str | None = None  #: `big-endian` or `little-endian`.
    pointer_bits: int | None = None  #: Size of an address, bits.


class TargetRun(Record, frozen=True, kw_only=True):
    """The target on which calls were measured [4.2.1, 4.3.1]; the rows of these calls have the part `target`."""

    name: str  #: Name of the target.
    about: TargetRecord | None = None  #: Facts reported by the board; null if the run was not made by the harness.
    matched_share: float | None = None  #: Fraction of estimates that have a call; null if the calls have no stamps.
    other_run: str | None = None  #: Run of the calls; null if it is the run of the estimate.
    memory_method: str | None = None  #: Method of measuring memory; null if memory was not measured.


class MethodKind(StrEnum):
    """How the suite runs a method under test."""

    BUILT_IN = "built-in"  #: A part of this suite.
    PEER = "peer"  #: Known to this suite, and installed by the user in a separate interpreter.
    PYTHON = "python"  #: A Python class.
    LIBRARY = "library"  #: A C library behind the ABI of `sfr_candidate.h`.
    EXTERNAL = "external"  #: An external ROS node.


class FindingKind(StrEnum):
    """Fault of a method in a call."""

    CRASHED = "crashed"  #: The process of the method ended.
    HANGING = "hanging"  #: The method did not return in time and was terminated.
    OUT_OF_MEMORY = "out of memory"  #: The method exceeded its memory limit and was terminated.
    LEAKING = "leaking"  #: The method holds more memory after every call.
    RAISED = "raised"  #: The method raised an error or reported a failure.
    NOT_FINITE = "not finite"  #: A number of the result is NaN or infinite.
    WRONG_STAMP = "wrong stamp"  #: The result has the stamp of another pair.
    MISSING = "missing answer"  #: An external node did not answer a pair.
    EARLY = "early answer"  #: An external node answered a pair before the last image of the pair was published.
    LATE = "late answer"  #: An external node answered after the time to answer.
    DOUBLED = "doubled answer"  #: An external node answered a pair more than once.
    MISSTATED = "misstated"  #: The reported time or memory contradicts the measurement from outside.
    OTHER_FRAME = "another frame"  #: An answer of an external node has other frame ids than required.
    INVALID_RESULT = "invalid result"  #: The result has another type, size or meaning than specified.

    @property
    def fails(self) -> bool:
        """Whether the finding prevents a pass; pairs without an answer make an estimate incomplete."""
        return self not in (FindingKind.MISSING, FindingKind.LATE, FindingKind.DOUBLED, FindingKind.OTHER_FRAME)


class CallFinding(NamedTuple):
    """The fault of a method in one call. The record of the call and its row in a file have the text `KIND: TEXT`.

    A call with several faults has their texts, separated by `; `.
    """

    kind: FindingKind
    text: str

    def __str__(self) -> str:
        """Return the finding as in the record of a call."""
        return f"{self.kind}: {self.text}"

    @classmethod
    def all_in(cls, text: str) -> list[CallFinding]:
        """Return the findings of the record of a call; parts of the text that name no fault are ignored."""
        parts = (part.partition(": ") for part in _NEXT_FINDING.split(text))
        return [cls(FindingKind(word), rest) for word, _, rest in parts if word in set(FindingKind)]


FINDING_SEPARATOR = "; "  #: Between the findings in the record of a call.
_NEXT_FINDING = re.compile(f"{FINDING_SEPARATOR}(?=(?:{'|'.join(FindingKind)}): )")


class MethodRecord(Record, frozen=True, kw_only=True):
    """The software that made the estimate or the cloud."""

    name: str  #: Name of the method.
    version: str | None  #: Version that the method reports; null if it reports none.
    kind: MethodKind  #: How the suite runs the method: built-in, peer, Python class, C library or external ROS node.
    sha256: str | None = None  #: Hash of the file that the method was loaded from; null if it is not a single file.
    #: Hash of the text of the configuration, of `variables` and of the files in SFR_METHOD_FILES; for the built-in
    #: method, of the settings that differ from the defaults. Null without a configuration, or if the configuration is
    #: unknown.
    config_sha256: str | None = None
    isolation: str | None = None  #: Isolation of the process of the method; null if unknown or not required.
    can_read_all_files: bool = False  #: Whether the system could not isolate the process from the files of its user.
    #: Further paths that the user permitted the method to read, separated as in PATH.
    readable_files: str | None = None
    #: Environment variables with settings of numerical libraries that the process received, `NAME=VALUE NAME=VALUE`.
    variables: str | None = None

    def __post_init__(self) -> None:
        """Write name and version, which the method or a file states, in one line without control characters."""
        for field in ("name", "version"):
            text = getattr(self, field)
            if text is not None:
                msgspec.structs.force_setattr(self, field, printable(" ".join(text.split())))


class FindingRecord(Record, frozen=True, kw_only=True):
    """Calls of a method with one kind of fault."""

    kind: FindingKind  #: Kind of fault.
    count: int  #: Number of calls with the fault.
    first_stamp_ns: int | None  #: Stamp of the first of these calls.
    text: str  #: Description of the fault of the first call, in one line.

    def __str__(self) -> str:
        """Return the finding as one line."""
        calls = "1 call" if self.count == 1 else f"{self.count} calls, the first"
        stamp = "" if self.first_stamp_ns is None else f" at stamp {self.first_stamp_ns}"
        return f"{self.kind}: {calls}{stamp}: {self.text}"


class AnswerCounts(Record, frozen=True, kw_only=True, omit_defaults=False):
    """Numbers of the pairs that were published to an external node, and of its answers by category."""

    pairs: int = 0  #: Pairs that were published to the node.
    answered: int = 0  #: Pairs with a usable answer that has the same stamp and arrived within the answer timeout.
    missing: int = 0  #: Pairs without a usable answer within the answer timeout.
    early: int = 0  #: Answers before the last image of their pair was published.
    late: int = 0  #: Answers that were ignored because they arrived after the answer timeout.
    doubled: int = 0  #: Answers that were ignored because their pair had been answered before.
    other_stamp: int = 0  #: Answers whose stamp is not that of a pair; they are not used.
    other_frame: int = 0  #: Answers that were ignored because their frame ids are not the required ones.
    not_usable: int = 0  #: Answers that were ignored as invalid, for example not finite or without x, y, z.


class ProcessUsage(Record, frozen=True, kw_only=True):
    """Resources of the processes of a method, measured from outside."""

    cpu_s: float  #: CPU time of all processes, user and system, s.
    #: CPU time between the calls, and in excess of what the threads can use within the calls, s; null for an external
    #: node.
    cpu_outside_s: float | None = None
    peak_rss_bytes: int  #: Peak of the sum of the resident memory of the processes.
    processes: int  #: Largest number of processes.
    threads: int | None = None  #: Largest number of threads of the processes; null for an external node.
    method: str  #: Method of measurement.


class ExternalScore(Record, frozen=True, kw_only=True):
    """How an external node behaved."""

    task: str  #: `localisation` or `mapping`.
    topic: str  #: Topic of its answers.
    frames: str  #: Frame ids of its answers: `parent` or `parent -> child`.
    answers: AnswerCounts  #: Numbers of pairs and answers.
    latency_s: Statistics | None  #: Latency from publishing the last image of a pair to the answer; not a call time.
    process: ProcessUsage | None = None  #: CPU and memory of its processes; null if they were not measured.
    ended: str = ""  #: How its process ended during the run; empty if it did not end, or was not started by the suite.


class ConventionRecord(Record, frozen=True, kw_only=True):
    """How the poses were converted before they were scored."""

    declared: tuple[str, ...] = ()  #: Settings of the user, `NAME=VALUE`.
    diagnosed: str | None = None  #: Setting of the applied diagnosis; null if no diagnosis was applied.
    fitted: bool = False  #: Whether numbers of this setting were fitted to the ground truth, which reduces the errors.
    sentence: str | None = None  #: Fault that the diagnosis reports; null without a diagnosis.


class InputFile(Record, frozen=True, kw_only=True):
    """An input of the score."""

    path: str  #: Path as given by the user.
    resolved: str | None = None  #: Absolute path without links when the score was made; null if unknown or in memory.
    sha256: str  #: Hash of the content.
    #: For a ground truth with settings in the configuration of its source: hash of `sha256` and of these settings.
    declared_sha256: str | None = None
    data_sha256: str | None = None  #: For a ground truth: hash of its poses and sigmas, or of its points.
    read_from: str | None = None  #: For a ground truth: topic, frame or file of the poses; null if unknown.

    @property
    def data_set_sha256(self) -> str:
        """The hash by which limits name this input (`data_set_sha256`)."""
        return self.sha256 if self.declared_sha256 is None else self.declared_sha256


class Provenance(Record, frozen=True, kw_only=True):
    """Inputs, software and host with which the score was made."""

    version: str  #: Version of this suite.
    commit: str | None = None  #: Commit that the suite was installed from; null if unknown.
    command: str | None = None  #: Command that reproduces the figures; null if unknown.
    inputs: dict[str, InputFile] = {}  #: Files by role.
    configuration: dict[str, Any] = {}  #: Active settings.
    host: dict[str, str] = {}  #: Machine, system and Python.
    time: str | None = None  #: Time of the score, ISO 8601.
