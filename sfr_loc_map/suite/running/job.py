"""A job of a suite: its inputs, and its identities.

A source has these identities:

    sha256             hash of the content, or of the settings of a simulation: part of the key of a job
    input_identity     data that a method receives; of an estimate, name and truth: part of the pairing
    drive_identity     drive, which copies of the source share: part of the drive key
    source_identities  (of a description) name with path, and data: a later plan has the same source if either is equal

A job has these identities:

    key           hash of all inputs of the result except names and paths of sources; names the files of the job
    description   names and inputs that the files of the job state, so that a later plan recognises the work
    work          (of a description) task, faults, their seed and repeat: with the source, what must stay planned
    pairing       data, task, faults, repeat and scoring: pairs jobs of two suites, even with other code or parameters
    group         task, configuration and faults: the errors of a group are pooled
    drive_key     drive, task and faults: repeats and copies of a drive share this hash, because their errors depend on
                  each other. Sequential tests take the drives in the order of this hash
    label         the displayed name

`plan_check` compares the jobs of two plans by a hash of their content without paths and code.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import NamedTuple

from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.stored.score_json import from_plain, to_plain

KEY_LENGTH = 32  #: Hexadecimal digits of a key. The probability of a collision among 10^9 results is 10^-21.
SHORT_KEY = 12  #: Displayed digits of a key.
OF_SUITE = "suite."  #: Prefix of the description of a job in the provenance of its score.
NO_CONFIGURATION = "-"  #: Name of the configuration of jobs without parameters.


class JobTask(StrEnum):
    """Task of a job: an entry of `tasks` of the suite's file, or `score` for estimates.

    To add a task, add a member here, a row in `PARAMETERS_OF_TASK`, the condition in `tasks_for`, and a function in
    `RUN_OF_TASK` (`job_run.py`).
    """

    LOCALISE = "localise"
    MAP = "map"
    SCORE = "score"
    REPLAY = "replay"


PARAMETERS_OF_TASK = {JobTask.LOCALISE: "localisation.", JobTask.MAP: "mapping.", JobTask.REPLAY: "", JobTask.SCORE: ""}
"""By task: prefix of the parameters that the jobs of the task use. Other parameters are not part of such a job."""


def tasks_for(*, has_drive: bool, has_panorama: bool) -> tuple[JobTask, ...]:
    """Return the tasks for which a source with localisation pairs or mapping pairs has data."""
    has_data = {JobTask.LOCALISE: has_drive, JobTask.MAP: has_panorama, JobTask.REPLAY: has_drive or has_panorama}
    return tuple(task for task, has in has_data.items() if has)


class SourceKind(StrEnum):
    """Origin of the data of a source. To add a kind, add a member here and a class in `source_readers.py`."""

    FILE = "file"
    REMOTE = "remote"  #: Only before the plan, which fetches the source and makes it a `FILE`.
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
    #: Hashes of estimate, truth and calls by their role in the provenance of the score; empty for other kinds.
    input_sha256: Mapping[str, str] = field(default_factory=dict)
    state: str = ""  #: State of the files before they were hashed (`state_of`); empty without files.
    drive: str = ""  #: Hash of the drive of the source, which copies share; empty before the plan.
    variant: str = ""  #: Variant of an error budget (`variants.py`); otherwise empty.
    faults: str = ""  #: Faults that belong to the variant, joined by `+`.
    seed: int = 0  #: Seed of a simulation; otherwise 0.
    identical: tuple[str, ...] = ()  #: Names of further sources with the same data, which have the same jobs.

    @property
    def input_identity(self) -> tuple[str, ...]:
        """Identity of the data that a method under test receives; of an estimate, its name and its truth."""
        return (self.name, self.truth_sha256) if self.kind is SourceKind.ESTIMATE else (self.sha256,)

    @property
    def drive_identity(self) -> tuple[SourceKind, str]:
        """Identity of the drive, which copies of the source share."""
        return self.kind, self.drive or self.truth_sha256 or self.sha256


class GroupKey(NamedTuple):
    """What the jobs of a group have in common."""

    task: str
    configuration: str
    faults: str  #: Injected faults, or the variant of an error budget.

    @property
    def parts(self) -> tuple[str, ...]:
        """The displayed parts; a job without parameters has no configuration."""
        return tuple(part for part in self if part not in ("", NO_CONFIGURATION))

    @property
    def text(self) -> str:
        """Displayed name: `localise, default, black:share=0.1`."""
        return ", ".join(self.parts)


@dataclass(frozen=True, slots=True, kw_only=True)
class JobDescription:
    """Names and inputs of a job that its result or its failure states."""

    task: str = ""
    source: str = ""  #: Name of the source.
    source_sha256: str = ""
    path: str = ""  #: Path of the source.
    key: str = ""  #: Key of the job; empty if the file does not name its job.
    faults: str = ""
    fault_seed: int = 0
    configuration: str = ""
    repeat: int = 0
    start: str = ""
    code: str = ""

    @property
    def work(self) -> tuple[object, ...]:
        """What the job does with its source, independently of the code and of the configuration."""
        return (self.task, self.faults, effective_seed(self.faults, self.fault_seed), self.repeat)

    def source_identities(self, cache: Path) -> tuple[object, object]:
        """Return name with path, and data of the source. Two sources are the same if either identity is equal.

        A name alone is no identity: names may be equal, and the name of a simulation depends on the others. A source
        that was fetched to the cache has a folder for each version, so that only the name of its file counts.
        """
        is_fetched = cache.absolute() in Path(self.path).parents
        return (self.source, Path(self.path).name if is_fetched else self.path), self.source_sha256

    def to_provenance(self) -> dict[str, object]:
        """Return the description as entries of the configuration in a provenance."""
        return {f"{OF_SUITE}{name}": value for name, value in to_plain(self).items()}

    @staticmethod
    def from_provenance(configuration: Mapping[str, object]) -> JobDescription:
        """Return the description in the configuration of a provenance; RecordError if an entry has another type."""
        entries = {
            name.removeprefix(OF_SUITE): value for name, value in configuration.items() if name.startswith(OF_SUITE)
        }
        return from_plain(JobDescription, entries)


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """One unit of work of a suite: a pure function of its fields."""

    task: JobTask
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
    order_seed: int = 0  #: Seed of the order of the drives; not an input of the result.
    #: Figures and conditions for which all errors are kept, because their tolerance bound is limited.
    kept_errors: tuple[tuple[str, str], ...] = ()

    @property
    def key(self) -> str:
        """Hash of all inputs of the result.

        The path of a method from a file is a parameter and therefore part of the key.
        """
        faults = [self.faults, effective_seed(self.faults, self.fault_seed)]
        how = [self.parameters, self.start, self.scoring, self.kept_errors, self.repeat, self.threads]
        return digest([self.task, [self.source.kind, self.source.sha256], *faults, *how, self.code])

    @property
    def description(self) -> JobDescription:
        """Names and inputs that the result and the failure of the job state."""
        return JobDescription(
            task=self.task.value,
            source=self.source.name,
            source_sha256=self.source.sha256,
            path=self.source.path,
            key=self.key,
            faults=self.faults,
            fault_seed=self.fault_seed,
            configuration=self.configuration,
            repeat=self.repeat,
            start=self.start,
            code=self.code,
        )

    @property
    def pairing(self) -> str:
        """Hash of work and data, by which jobs of two suites are paired in a comparison.

        Estimates of one name and one ground truth are paired, because they are the results of two methods.
        """
        faults = [self.faults, effective_seed(self.faults, self.fault_seed)]
        data = [self.task, self.source.kind, *self.source.input_identity, *faults, self.repeat]
        return digest([*data, self.start, self.scoring])

    @property
    def group(self) -> GroupKey:
        """Group of the job."""
        return GroupKey(self.task.value, self.configuration, self.alteration)

    @property
    def drive_key(self) -> str:
        """Hash that repeats and copies of one drive share. Their errors are not independent.

        With `order_seed` 0 the order of the hashes follows from the data of the drives.
        """
        seed = [self.order_seed] if self.order_seed else []
        return digest([self.task, *self.source.drive_identity, self.faults, *seed])

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
        return f"{self.task} {self.source.name}{faults}{configuration}{repeat}"


def effective_seed(faults: str, fault_seed: int) -> int:
    """Return the seed that selects the affected pairs; 0 without faults, because the seed then has no effect."""
    return fault_seed if faults else 0


def digest(value: object) -> str:
    """Return the hash of records and plain values, as JSON with sorted keys."""
    text = json.dumps(to_plain(value), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:KEY_LENGTH]
