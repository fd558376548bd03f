"""The errors of the suite: one root, one subclass per layer, and the exit code of each.

A message is one line that states what failed, what was found and what to do. The library raises errors. `cli.main`
prints an error that ends a command, and `nodes.lifecycle.runner` prints an error that prevents the start of a node.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from enum import IntEnum
from pathlib import Path
from typing import ClassVar


class ExitCode(IntEnum):
    """Exit codes of all commands."""

    OK = 0
    FAILED = 1
    """A limit was missed, or the doctor found a problem."""
    BAD_INPUT = 2
    """The input or the usage is invalid."""
    NOT_JUDGED = 3
    """A limit, a condition or the complete result could not be judged. With `--lenient` the exit code is 0."""
    FAULT = 70
    """The program has a fault: an exception that it does not raise deliberately (EX_SOFTWARE of sysexits.h)."""
    INTERRUPTED = 130
    """SIGINT, SIGTERM or SIGHUP interrupted the command. Finished results are reported."""


class SfrError(Exception):
    """Root of every error that the suite raises deliberately.

    The message is the finding, followed by the advice if there is one. Such a finding ends in a colon or a semicolon.
    """

    exit_code: ClassVar[ExitCode] = ExitCode.BAD_INPUT

    def __init__(self, finding: str = "", advice: str = "") -> None:
        super().__init__(f"{finding} {advice}" if advice else finding)
        self.finding = finding
        self.advice = advice

    @property
    def problem(self) -> str:
        """The finding without the punctuation before the advice."""
        return self.finding.rstrip(":;")


class ConfigError(SfrError):
    """A configuration value or file is not valid."""


class GeometryError(SfrError):
    """A transform, rotation, rig or trajectory is not valid."""


class InputError(SfrError):
    """A source (folder, bag, trajectory, cloud) is missing, broken or incomplete."""


class OutputError(SfrError):
    """An output cannot be written."""


class MetricsError(SfrError):
    """Figures cannot be computed from the given data."""


class MappingError(SfrError):
    """A set of stereo pairs cannot be mapped."""


class LocalisationError(SfrError):
    """A stereo pair cannot be passed to the localiser (wrong size or type)."""


class NodeError(SfrError):
    """A node or its ROS graph does not work as required."""


class MethodError(SfrError):
    """A method under test cannot be found or started."""


class MissingExtraError(SfrError):
    """An optional dependency is not installed."""


class FailedVerdictError(SfrError):
    """A figure missed its limit, or the doctor found a problem. The input is valid."""

    exit_code = ExitCode.FAILED


class NotJudgedError(SfrError):
    """A result cannot be judged: data are missing, or estimate and truth have different conventions."""

    exit_code = ExitCode.NOT_JUDGED


class InterruptedRunError(SfrError):
    """The user interrupted a run. The message states what was finished."""

    exit_code = ExitCode.INTERRUPTED


@contextmanager
def naming(source: Path | str) -> Iterator[None]:
    """Add the name of a source to the errors that it causes, unless they contain the name.

    A path is put in quotes before the message. A text, such as `image of stamp 3`, is put there unchanged.
    """
    try:
        yield
    except (InputError, GeometryError, LocalisationError, MappingError) as error:
        if str(source) in str(error):
            raise
        where = f"'{source}'" if isinstance(source, Path) else source
        raise type(error)(f"{where}: {error.finding}", error.advice) from error


@contextmanager
def naming_key(origin: str) -> Iterator[None]:
    """Add the file and the key to the errors of a parser that knows neither; raise each error as a ConfigError.

    An empty origin adds nothing.
    """
    try:
        yield
    except (ConfigError, MetricsError) as error:
        raise ConfigError(f"{origin}: {error.finding}" if origin else error.finding, error.advice) from error
