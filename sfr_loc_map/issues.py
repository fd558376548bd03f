"""Issues of a recording, a ROS graph or a topic, each with its fix."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Cause(StrEnum):
    """Causes of issues. Their values are public: programs read them, and docs/operating.md explains each."""

    BROKEN = "broken"
    UNFINISHED = "unfinished"
    MISSING_IMAGES = "missing_images"
    AMBIGUOUS = "ambiguous"
    NO_TOPIC = "no_topic"
    NO_PUBLISHER = "no_publisher"
    WRONG_TYPE = "wrong_type"
    QOS = "qos"
    SILENT = "silent"
    SEVERAL_PUBLISHERS = "several_publishers"
    TRANSPORT = "transport"
    CAMERA_INFO = "camera_info"
    ENCODING = "encoding"
    IMAGE_SIZE = "image_size"
    SWAPPED = "swapped"
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


@dataclass(frozen=True, slots=True)
class Issue:
    """An issue of a recording, a graph or a topic."""

    cause: Cause
    where: str  #: Topic, node or file.
    text: str  #: What was observed.
    fix: str
    is_blocking: bool = True  #: Whether the issue prevents a useful result; otherwise it is a warning.
    command: str = ""  #: Command line that removes the cause; empty if there is none.

    def as_dict(self) -> dict[str, str | bool]:
        """Return the issue for JSON."""
        about = {"cause": self.cause.value, "is_blocking": self.is_blocking, "where": self.where}
        return about | {"text": self.text, "fix": self.fix}
