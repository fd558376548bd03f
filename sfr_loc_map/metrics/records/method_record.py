"""The part `method` of the score: whose software the figures are of."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class MethodKind(StrEnum):
    """How a method under test is reached."""

    BUILT_IN = "built-in"
    """A part of this suite."""
    PYTHON = "python"
    """A Python class."""
    LIBRARY = "library"
    """A C library behind the ABI of `sfr_candidate.h`."""
    EXTERNAL = "external"
    """A ROS node that was not started from this suite's code."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MethodRecord:
    """The software that made the estimate or the cloud.

    Attributes:
        name: Its name.
        version: As it says itself, None where it does not.
        kind: How it is reached.
    """

    name: str
    version: str | None
    kind: MethodKind
