"""The errors of the suite: one root, one subclass per layer, and the exit code of each.

A message is one line that says what was sought, what was found and what to do. The library raises; only
`sfr_loc_map.cli` prints and exits.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from enum import IntEnum
from typing import ClassVar


class ExitCode(IntEnum):
    """What a command exits with; the same table for all commands."""

    OK = 0
    FAILED = 1
    """A limit was missed, or the doctor found something."""
    BAD_INPUT = 2
    """Input or usage."""
    NOT_JUDGED = 3
    """Nothing could be judged; with `--lenient` 0."""
    INTERRUPTED = 130
    """By SIGINT, SIGTERM or SIGHUP; what was finished is reported."""


class SfrError(Exception):
    """Root of every error that the suite raises deliberately."""

    exit_code: ClassVar[ExitCode] = ExitCode.BAD_INPUT


class ConfigError(SfrError):
    """A configuration value or file is not valid."""


class GeometryError(SfrError):
    """A transform, rotation, rig or trajectory is not valid."""


class InputError(SfrError):
    """A source (folder, bag, trajectory, cloud) is missing, broken or incomplete."""


class OutputError(SfrError):
    """An output cannot be written."""


class MetricsError(SfrError):
    """Figures cannot be computed from what was given."""


class MappingError(SfrError):
    """A set of stereo pairs cannot be mapped."""


class LocalisationError(SfrError):
    """A stereo pair cannot be handed to the localiser (wrong size or type)."""


class NodeError(SfrError):
    """A node, or the graph it lives in, cannot do its work."""


class MethodError(SfrError):
    """A method under test cannot be found or started."""


class MissingExtraError(SfrError):
    """An optional part is not installed."""


class FailedVerdictError(SfrError):
    """A figure missed its limit, or the doctor found something: not an error of input."""

    exit_code = ExitCode.FAILED


class NotJudgedError(SfrError):
    """There is no figure to judge: no data, or estimate and truth that contradict each other by convention."""

    exit_code = ExitCode.NOT_JUDGED


class InterruptedRunError(SfrError):
    """The user ended a run; says what was finished."""

    exit_code = ExitCode.INTERRUPTED


@contextmanager
def naming(source: object) -> Iterator[None]:
    """Let the errors that come of a source name it."""
    try:
        yield
    except (InputError, GeometryError, LocalisationError, MappingError) as error:
        if str(source) in str(error):
            raise
        raise type(error)(f"'{source}': {error}") from error
