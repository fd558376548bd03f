"""The parts `method` and `findings` of the score: whose software the figures are of, and what it did wrong."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class MethodKind(StrEnum):
    """How a method under test is reached."""

    BUILT_IN = "built-in"
    """A part of this suite."""
    PEER = "peer"
    """Known to this suite, installed by the user in an interpreter of its own."""
    PYTHON = "python"
    """A Python class."""
    LIBRARY = "library"
    """A C library behind the ABI of `sfr_candidate.h`."""
    EXTERNAL = "external"
    """A ROS node that was not started from this suite's code."""


class FindingKind(StrEnum):
    """What a method did wrong in a call."""

    CRASHED = "crashed"
    """Its process ended."""
    HANGING = "hanging"
    """It did not return in time and was ended."""
    OUT_OF_MEMORY = "out of memory"
    """It exceeded the memory that it may have and was ended."""
    LEAKING = "leaking"
    """The memory that it keeps after a call grows from call to call."""
    RAISED = "raised"
    """It raised an error or reported a failure."""
    NOT_FINITE = "not finite"
    """A number of its result is NaN or infinite."""
    WRONG_STAMP = "wrong stamp"
    """Its result is that of another pair."""
    MISSING = "missing answer"
    """An external node did not answer a pair."""
    LATE = "late answer"
    """An external node answered after its time to answer."""
    DOUBLED = "doubled answer"
    """An external node answered a pair again."""
    OTHER_FRAME = "another frame"
    """An answer of an external node names other frames."""
    INVALID_RESULT = "invalid result"
    """Its result has another type, size or meaning than agreed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MethodRecord:
    """The software that made the estimate or the cloud."""

    name: str  #: Its name.
    version: str | None  #: As it says itself, None where it does not.
    kind: MethodKind  #: How it is reached.
    sha256: str | None = None  #: Hash of the file that it was loaded from; None where it is not one file.


@dataclass(frozen=True, slots=True, kw_only=True)
class FindingRecord:
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
