"""What became of a job: its state, its outcome on a worker, its failure, and the record of the worker."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from sfr_loc_map.errors import (
    ConfigError,
    GeometryError,
    InputError,
    LocalisationError,
    MappingError,
    MetricsError,
    SfrError,
)
from sfr_loc_map.suite.jobs.job import Job, JobDescription

INPUT_ERRORS = (ConfigError, GeometryError, InputError, LocalisationError, MappingError, MetricsError)
"""Errors that the same job raises again on every worker, because of its source or its settings."""


class JobState(StrEnum):
    """State of a job, which follows from its files (`Store.state`)."""

    DONE = "done"
    FAILED = "failed"
    WAITING = "waiting"


class FailureCause(StrEnum):
    """Cause of the failure of a job."""

    BAD_INPUT = "bad input"
    FAULT = "fault of the program"
    DIED = "its process ended"
    MEMORY = "over the memory limit"
    TIME = "over the time limit"

    @classmethod
    def of(cls, error: SfrError) -> FailureCause:
        """Return the cause of an error of a job: bad input, or a fault of the program or of its worker."""
        return cls.BAD_INPUT if isinstance(error, INPUT_ERRORS) else cls.FAULT


@dataclass(frozen=True, slots=True, kw_only=True)
class JobOutcome:
    """Outcome of a job on a worker."""

    result: str | None = None  #: The score as JSON; None if the job failed.
    cause: FailureCause | None = None  #: Cause of the failure.
    message: str = ""  #: Text of the error, or the exceeded limit.
    worker: str = ""  #: Address of the worker.


@dataclass(frozen=True, slots=True)
class JobFailure:
    """A failed job with the cause."""

    key: str
    label: str
    source: str  #: Path of the source.
    cause: FailureCause
    message: str
    description: JobDescription
    configuration: str = ""
    pairing: str = ""  #: Hash that the same job in other suites shares.

    @classmethod
    def of(cls, job: Job, cause: FailureCause, message: str) -> JobFailure:
        """Return the failure of a job."""
        return cls(
            key=job.key,
            label=job.label,
            source=job.source.path,
            cause=cause,
            message=message,
            description=job.description,
            configuration=job.configuration,
            pairing=job.pairing,
        )


@dataclass(slots=True, kw_only=True)
class WorkerRecord:
    """Record of a worker in suite.json."""

    worker: str  #: Address of the worker.
    host: str = ""
    version: str = ""  #: Version of sfr_loc_map.
    python: str = ""
    code: str = ""  #: Fingerprint of the code of the worker.
    done: int = 0  #: Number of jobs with a result.
    set_aside: str = ""  #: Why the worker gets no jobs: the difference of its code; empty if it has none.
