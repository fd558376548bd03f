"""One run of a suite: what it depends on, the key that names its result, and what came of it where."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.score_json import to_plain

KEY_LENGTH = 32  #: Hexadecimal digits of a key: two of 10^9 results agree by chance with a probability of 10^-21.
SHORT_KEY = 12  #: Digits of a key that name a job to people.
NO_CONFIGURATION = "-"  #: Of jobs that take no parameters.


class JobKind(StrEnum):
    """What is done with a source: an entry of `tasks`, or `score` for estimates."""

    LOCALISE = "localise"
    MAP = "map"
    SCORE = "score"
    REPLAY = "replay"


class SourceKind(StrEnum):
    """Where the data of a source come from."""

    FILE = "file"
    REMOTE = "remote"
    SIMULATED = "simulated"
    ESTIMATE = "estimate"


@dataclass(frozen=True, slots=True, kw_only=True)
class JobSource:
    """The data that a job reads."""

    name: str  #: Short name, unique in the suite.
    kind: SourceKind  #: Where the data come from.
    path: str  #: The source, its URL before the plan, the scenario, or the estimate.
    truth: str = ""  #: Truth of an estimate, otherwise empty.
    settings: Mapping[str, object] = field(default_factory=dict)  #: All settings of a simulation, otherwise empty.
    sha256: str  #: Hash of the content, or of the settings; empty before the plan.
    truth_sha256: str = ""  #: Hash of the truth of an estimate alone, otherwise empty.
    drive: str = ""  #: Hash of the drive that the source is of, which its copies share; empty before the plan.
    variant: str = ""  #: Variant of an error budget (`suite/running/variants.py`), otherwise empty.
    faults: str = ""  #: Faults that belong to the variant, joined by `+`.
    seed: int = 0  #: Seed of a simulation, otherwise 0.


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """One run: a pure function of its fields."""

    kind: JobKind  #: What is done.
    source: JobSource  #: The data.
    faults: str = ""  #: Injected faults, joined by `+`; empty for none.
    fault_seed: int  #: Seed of which pairs they affect.
    configuration: str  #: Name of the configuration.
    #: Parameters that differ from the defaults, by dotted name (`localisation.max_features`).
    parameters: Mapping[str, object] = field(default_factory=dict)
    start: str  #: First pose: `identity` or `truth`.
    scoring: TrajectoryScoreConfig  #: How it is scored.
    repeat: int  #: Number of the repetition, from 0.
    threads: int  #: Threads that it may use.
    code: str  #: Fingerprint of the code.
    #: Figures and conditions of which all errors are kept, because a limit is on their tolerance bound.
    kept_errors: tuple[tuple[str, str], ...] = ()

    @property
    def key(self) -> str:
        """Name of the result: a hash of all that the result depends on; names and places of files are not among it."""
        faults = [self.faults, self.fault_seed if self.faults else 0]
        how = [self.parameters, self.start, self.scoring, self.kept_errors, self.repeat, self.threads]
        return digest([self.kind, [self.source.kind, self.source.sha256], *faults, *how, self.code])

    @property
    def alteration(self) -> str:
        """What the source was changed by: the variant of a budget, or the faults; empty for neither."""
        return self.source.variant or self.faults

    @property
    def label(self) -> str:
        """Name for people: `localise rocky-7 + black:share=0.1, default, repeat 2`."""
        faults = f" + {self.alteration}" if self.alteration else ""
        repeat = f", repeat {self.repeat}" if self.repeat else ""
        configuration = "" if self.configuration == NO_CONFIGURATION else f", {self.configuration}"
        return f"{self.kind} {self.source.name}{faults}{configuration}{repeat}"

    @property
    def drive(self) -> str:
        """What repeats and copies of one drive have in common; their errors are not independent."""
        source = self.source
        return digest([self.kind, source.kind, source.drive or source.truth_sha256 or source.sha256, self.faults])

    @property
    def pairing(self) -> str:
        """What jobs of two suites have in common that are compared: the same work on the same data."""
        data = [self.kind, self.source.kind, self.source.sha256, self.faults, self.fault_seed, self.repeat]
        return digest([*data, self.start, self.scoring])


class FailureCause(StrEnum):
    """Why a job failed."""

    BAD_INPUT = "bad input"
    FAULT = "fault of the program"
    DIED = "its process ended"
    MEMORY = "over the memory limit"
    TIME = "over the time limit"


@dataclass(frozen=True, slots=True, kw_only=True)
class JobOutcome:
    """What came of a job."""

    result: str | None = None  #: The score as JSON; None if it failed.
    cause: FailureCause | None = None  #: Why it failed.
    message: str = ""  #: The error, or the limit.
    worker: str = ""  #: Address of the worker that ran it.


@dataclass(slots=True, kw_only=True)
class WorkerRecord:
    """A worker of a suite, as suite.json names it."""

    worker: str  #: Its address.
    host: str = ""
    version: str = ""  #: Of sfr_loc_map.
    python: str = ""
    code: str = ""  #: Fingerprint of its code.
    done: int = 0  #: Tasks.
    set_aside: str = ""  #: How its code differs, so that it gets no task; empty if it may run tasks.


def digest(value: object) -> str:
    """Return the hash of records and plain values, as JSON with sorted keys."""
    text = json.dumps(to_plain(value), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:KEY_LENGTH]
