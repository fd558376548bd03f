"""A job of a suite: its inputs, the key that names its result, its outcome and its worker."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.score_json import to_plain

KEY_LENGTH = 32  #: Hexadecimal digits of a key. The probability of a collision among 10^9 results is 10^-21.
SHORT_KEY = 12  #: Displayed digits of a key.
OF_SUITE = "suite."  #: Prefix of the description of a job in the provenance of its score.
NO_CONFIGURATION = "-"  #: Name of the configuration of jobs without parameters.


class JobKind(StrEnum):
    """Task of a job: an entry of `tasks` of the suite's file, or `score` for estimates.

    A further kind is a member here, a row in `RUN_OF_KIND` (`job_run.py`), and a row in `possible_kinds` and in
    `PARAMETERS_OF_KIND` (`plan.py`).
    """

    LOCALISE = "localise"
    MAP = "map"
    SCORE = "score"
    REPLAY = "replay"


class SourceKind(StrEnum):
    """Origin of the data of a source."""

    FILE = "file"
    REMOTE = "remote"
    SIMULATED = "simulated"
    ESTIMATE = "estimate"


@dataclass(frozen=True, slots=True, kw_only=True)
class JobSource:
    """The data that a job reads."""

    name: str  #: Short name, unique in the suite; the variants of an error budget share the name of their simulation.
    kind: SourceKind  #: Origin of the data.
    path: str  #: Path of the source (before the plan, its URL), of the scenario, or of the estimate.
    truth: str = ""  #: Truth of an estimate; otherwise empty.
    settings: Mapping[str, object] = field(default_factory=dict)  #: All settings of a simulation; otherwise empty.
    sha256: str  #: Hash of the content, or of the settings; empty before the plan.
    truth_sha256: str = ""  #: Hash of the truth of an estimate; otherwise empty.
    drive: str = ""  #: Hash of the drive of the source, which copies share; empty before the plan.
    variant: str = ""  #: Variant of an error budget (`suite/running/variants.py`); otherwise empty.
    faults: str = ""  #: Faults that belong to the variant, joined by `+`.
    seed: int = 0  #: Seed of a simulation; otherwise 0.


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """One unit of work of a suite: a pure function of its fields."""

    kind: JobKind  #: Kind of the job.
    source: JobSource  #: The data.
    faults: str = ""  #: Injected faults, joined by `+`; empty if there are none.
    fault_seed: int  #: Seed that selects the affected pairs.
    configuration: str  #: Name of the configuration.
    #: Parameters that differ from the defaults, by dotted name (`localisation.max_features`).
    parameters: Mapping[str, object] = field(default_factory=dict)
    start: str  #: First pose: `identity` or `truth`.
    scoring: TrajectoryScoreConfig  #: Settings of the score.
    repeat: int  #: Number of the repetition, from 0.
    threads: int  #: Number of threads.
    code: str  #: Fingerprint of the code.
    #: Figures and conditions for which all errors are kept, because their tolerance bound is limited.
    kept_errors: tuple[tuple[str, str], ...] = ()

    @property
    def key(self) -> str:
        """Name of the result: a hash of all inputs of the result, without names and paths of sources.

        The path of a method from a file is a parameter and therefore part of the key.
        """
        faults = [self.faults, self.fault_seed if self.faults else 0]
        how = [self.parameters, self.start, self.scoring, self.kept_errors, self.repeat, self.threads]
        return digest([self.kind, [self.source.kind, self.source.sha256], *faults, *how, self.code])

    @property
    def description(self) -> dict[str, object]:
        """Description of the job that its result and its failure contain, by which both are assigned to the job."""
        return {
            "task": self.kind.value,
            "source": self.source.name,
            "source_sha256": self.source.sha256,
            "path": self.source.path,
            "key": self.key,
            "faults": self.faults,
            "fault_seed": self.fault_seed,
            "configuration": self.configuration,
            "repeat": self.repeat,
            "start": self.start,
            "code": self.code,
        }

    @property
    def alteration(self) -> str:
        """Variant of a budget or faults by which the source was changed; empty if there are none."""
        return self.source.variant or self.faults

    @property
    def label(self) -> str:
        """Displayed name: `localise rocky-7 + black:share=0.1, default, repeat 2`."""
        faults = f" + {self.alteration}" if self.alteration else ""
        repeat = f", repeat {self.repeat}" if self.repeat else ""
        configuration = "" if self.configuration == NO_CONFIGURATION else f", {self.configuration}"
        return f"{self.kind} {self.source.name}{faults}{configuration}{repeat}"

    @property
    def drive_key(self) -> str:
        """Hash that repeats and copies of one drive share. Their errors are not independent."""
        source = self.source
        return digest([self.kind, source.kind, source.drive or source.truth_sha256 or source.sha256, self.faults])

    @property
    def pairing(self) -> str:
        """Hash of work and data, by which jobs of two suites are paired in a comparison."""
        data = [self.kind, self.source.kind, self.source.sha256, self.faults, self.fault_seed, self.repeat]
        return digest([*data, self.start, self.scoring])


def work_of(description: Mapping[str, object]) -> tuple[object, ...]:
    """Return the work of a described job on its source, which other code or another configuration does not change.

    Without faults, the seed of the faults has no effect.
    """
    task, faults, fault_seed, repeat = (description.get(name) for name in ("task", "faults", "fault_seed", "repeat"))
    return (task, faults, fault_seed if faults else 0, repeat)


class FailureCause(StrEnum):
    """Cause of the failure of a job."""

    BAD_INPUT = "bad input"
    FAULT = "fault of the program"
    DIED = "its process ended"
    MEMORY = "over the memory limit"
    TIME = "over the time limit"


@dataclass(frozen=True, slots=True, kw_only=True)
class JobOutcome:
    """Outcome of a job."""

    result: str | None = None  #: The score as JSON; None if the job failed.
    cause: FailureCause | None = None  #: Cause of the failure.
    message: str = ""  #: The error, or the limit.
    worker: str = ""  #: Address of the worker.


@dataclass(slots=True, kw_only=True)
class WorkerRecord:
    """Record of a worker in suite.json."""

    worker: str  #: Address of the worker.
    host: str = ""
    version: str = ""  #: Version of sfr_loc_map.
    python: str = ""
    code: str = ""  #: Fingerprint of the code of the worker.
    done: int = 0  #: Number of jobs with a result.
    set_aside: str = ""  #: Difference of its code, because of which the worker gets no jobs; empty if there is none.


def digest(value: object) -> str:
    """Return the hash of records and plain values, as JSON with sorted keys."""
    text = json.dumps(to_plain(value), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:KEY_LENGTH]
