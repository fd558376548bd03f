"""The subjects of a score: which figures, expected items and task belong together (`SUBJECTS`)."""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple

from sfr_loc_map.suite_names import Task


class Subject(StrEnum):
    """Subject of a figure."""

    TRAJECTORY = "trajectory"
    MAP = "map"
    TIMING = "timing"
    MEMORY = "memory"
    COMPLETENESS = "completeness"
    CONSISTENCY = "consistency"
    EVIDENCE = "evidence"


class LimitSection(StrEnum):
    """Section of a limits file, named after the subject of its limits."""

    COMPLETENESS = "completeness"
    TRAJECTORY = "trajectory"
    MAP = "map"
    TIMING = "timing"
    MEMORY = "memory"
    TARGET = "target"


class Scope(StrEnum):
    """A part of a score that has expected items. The comments name the part and, after a colon, these items."""

    DRIVE = "drive"  #: The trajectory: images, or true poses if the images are unknown.
    MAP = "map"  #: The cloud: mapping pairs.
    CALLS = "calls"  #: The times of the calls of one kind: pairs.
    MEMORY = "memory"  #: The memory of the calls of one kind: pairs.
    LIVE = "live"  #: The messages of a live run.
    INPUTS = "inputs"  #: The inputs of a stored score: files and bags that exist at their recorded paths.
    SUITE = "suite"  #: The results of a suite.


class SubjectOfLimits(NamedTuple):
    """A subject that limits can be about, and what belongs to it."""

    subject: Subject
    scope: Scope | None  #: What must be complete for a pass of these limits; None if nothing has to be complete.
    task: Task | None
    """Task that these figures are about; None if the limit states the task (`judging.limited.task_of`)."""


SUBJECTS = (
    SubjectOfLimits(Subject.TRAJECTORY, Scope.DRIVE, Task.LOCALISATION),
    SubjectOfLimits(Subject.MAP, Scope.MAP, Task.MAPPING),
    SubjectOfLimits(Subject.TIMING, Scope.CALLS, None),
    SubjectOfLimits(Subject.MEMORY, Scope.MEMORY, None),
    SubjectOfLimits(Subject.COMPLETENESS, None, None),
)
"""The subjects of limits. The other subjects have no limits."""
SCOPE_OF = {each.subject: each.scope for each in SUBJECTS}
"""The scope that must be complete for a pass of a limit, by the subject of the limited figure."""
SUBJECT_OF = {each.task: each for each in SUBJECTS if each.task is not None}
"""The subject of the errors of a task."""
