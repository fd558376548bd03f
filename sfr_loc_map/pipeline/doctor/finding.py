"""What a check finds."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Severity(StrEnum):
    """What a finding means for the suite."""

    BLOCKING = "blocking"
    """Something that is needed does not work."""
    WARNING = "warning"


class Cause(StrEnum):
    """Kinds of findings, for programs."""

    BROKEN = "broken"
    UNFINISHED = "unfinished"
    MISSING_IMAGES = "missing_images"
    AMBIGUOUS = "ambiguous"
    NO_TOPIC = "no_topic"
    NO_PUBLISHER = "no_publisher"
    WRONG_TYPE = "wrong_type"
    QOS = "qos"
    SILENT = "silent"
    TRANSPORT = "transport"
    CAMERA_INFO = "camera_info"
    ENCODING = "encoding"
    IMAGE_SIZE = "picture_size"
    SWAPPED = "exchanged"
    STAMP_ORDER = "stamp_order"
    UNSYNCHRONISED = "unsynchronised"
    UNPAIRED = "unpaired"
    POSE_STAMPS = "pose_stamps"
    TRUTH = "truth"
    TRUTH_CLOCK = "truth_clock"
    CLOCKS_APART = "clocks_apart"
    FRAMES = "frames"
    CLOCK = "clock"
    INACTIVE = "inactive"
    SHARED_MEMORY = "shared_memory"


@dataclass(frozen=True, slots=True)
class Finding:
    """One issue.

    Attributes:
        cause: Its kind.
        severity: Whether it blocks.
        where: Topic, node or file.
        text: What was found.
        fix: What to do.
    """

    cause: Cause
    severity: Severity
    where: str
    text: str
    fix: str

    @property
    def is_blocking(self) -> bool:
        """Tell whether something that is needed does not work."""
        return self.severity is Severity.BLOCKING

    def as_dict(self) -> dict[str, str | bool]:
        """Return it for JSON, under the public keys."""
        return {
            "cause": self.cause.value,
            "stops": self.is_blocking,
            "where": self.where,
            "text": self.text,
            "cure": self.fix,
        }


def blocking(cause: Cause, where: str, text: str, fix: str) -> Finding:
    """Return a finding that blocks."""
    return Finding(cause, Severity.BLOCKING, where, text, fix)


def warning(cause: Cause, where: str, text: str, fix: str) -> Finding:
    """Return a finding that does not block."""
    return Finding(cause, Severity.WARNING, where, text, fix)
