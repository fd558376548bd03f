"""A job of a suite: its inputs, and its identities.

    key           hash of all inputs of the result; names the files of the job. Names and paths of sources and the names
                  of configurations are not inputs, so that a renamed source or configuration keeps its results
    pairing       hash of data, task, faults, repeat, first pose and scoring: pairs jobs of two suites, even with other
                  code or parameters; `PairKey` adds the configuration if a suite has several
    drive_key     hash of drive, task and faults: repeats and copies of a drive share this hash, because their errors
                  depend on each other
    drive_order   extension of the suite that added the drive, and `drive_key`: order of sequential tests
    measurement   hash of the inputs without those of the score, by which a later plan recognises judged results
    group         task, configuration and alteration: the errors of a group are pooled
    label         the displayed name
    description   names and inputs that the files of the job state, so that a later plan recognises its work

`sources.py` lists the identities of sources.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import NamedTuple, TypeVar

from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.stored.score_json import from_plain, to_plain
from sfr_loc_map.suite.jobs.digests import digest
from sfr_loc_map.suite.jobs.sources import PlannedSource, Simulation

SHORT_KEY = 12  #: Displayed digits of a key.
PROVENANCE_PREFIX = "suite."  #: Prefix of the description of a job in the provenance of its score.
NATIVE_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Environment variables with the number of threads of compiled libraries, which a process reads when it starts."""
NO_CONFIGURATION = "-"  #: Name of the configuration of jobs without parameters.
T = TypeVar("T")


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


class GroupKey(NamedTuple):
    """What the jobs of a group have in common."""

    task: str
    configuration: str
    alteration: str  #: Change of the source: injected faults, or the variant of an error budget.

    @property
    def parts(self) -> tuple[str, ...]:
        """The displayed parts; a job without parameters has no configuration."""
        return tuple(part for part in self if part not in ("", NO_CONFIGURATION))

    @property
    def text(self) -> str:
        """Displayed name: `localise, default, black:share=0.1`."""
        return ", ".join(self.parts)


class DriveOrder(NamedTuple):
    """Place of a drive in the order of a group: by the extension that added the drive, then by the hash of its data.

    The order does not depend on the order of the suite's file. Drives that are added later come after the others, so
    that they do not change the decision of a sequential test.
    """

    extension: int  #: `Job.extension`.
    drive_key: str


class PairKey(NamedTuple):
    """Identity of a job among several suites."""

    pairing: str  #: Hash of work and data (`Job.pairing`).
    configuration: str  #: Name of the configuration; empty in `with_common_keys` of suites with one configuration.


def with_common_keys(suites: Sequence[Mapping[PairKey, T]]) -> list[dict[PairKey, T]]:
    """Return the jobs of several suites by the keys that pair the jobs.

    If each suite has only one configuration, its name is not part of the keys, so that the names may differ.
    """
    if any(len({key.configuration for key in jobs}) > 1 for jobs in suites):
        return [dict(jobs) for jobs in suites]
    return [{key._replace(configuration=""): job for key, job in jobs.items()} for jobs in suites]


@dataclass(frozen=True, slots=True, kw_only=True)
class JobDescription:
    """Names and inputs of a job that its result or its failure states."""

    task: str = ""
    source: str = ""  #: Name of the source.
    source_sha256: str = ""
    path: str = ""  #: Location of the source.
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

    @property
    def source_identities(self) -> tuple[object, object]:
        """Name with location, and data of the source. Two sources are the same if either identity is equal.

        A name alone is not an identity: names may be equal, and the name of a simulation depends on the others.
        """
        return (self.source, self.path), self.source_sha256

    def to_provenance(self) -> dict[str, object]:
        """Return the description as entries of the configuration in a provenance."""
        return {f"{PROVENANCE_PREFIX}{name}": value for name, value in to_plain(self).items()}

    @staticmethod
    def from_provenance(configuration: Mapping[str, object]) -> JobDescription:
        """Return the description in the configuration of a provenance; RecordError if an entry has another type."""
        entries = {
            name.removeprefix(PROVENANCE_PREFIX): value
            for name, value in configuration.items()
            if name.startswith(PROVENANCE_PREFIX)
        }
        return from_plain(JobDescription, entries)


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """One unit of work of a suite: a pure function of its fields."""

    task: JobTask
    source: PlannedSource  #: The data.
    faults: str = ""  #: Injected faults, joined by `+`; empty if there are none.
    fault_seed: int  #: Seed that selects the affected pairs.
    configuration: str  #: Name of the configuration.
    #: Parameters that differ from the defaults, by dotted name (`localisation.max_features`).
    parameters: Mapping[str, object] = field(default_factory=dict)
    #: SHA-256 of the files that the parameters name, by dotted name (`Configuration.input_files`).
    input_files: Mapping[str, str] = field(default_factory=dict)
    start: str  #: First pose: `identity` or `truth`.
    scoring: TrajectoryScoreConfig  #: Settings of the score.
    repeat: int  #: Number of the repetition, from 0.
    threads: int  #: Number of threads.
    code: str  #: Fingerprint of the code.
    #: Figures and conditions for which all errors are kept, because their tolerance bound is limited.
    kept_errors: tuple[tuple[str, str], ...] = ()
    extension: int = 0  #: Number of the extension of the suite that added the drive (`planning.looks`).

    @property
    def key(self) -> str:
        """Hash of all inputs of the result.

        The path of a method from a file is a parameter and therefore part of the key.
        """
        data = [self.source.kind, self.source.sha256]
        faults = [self.faults, effective_seed(self.faults, self.fault_seed)]
        settings = [self.parameters, self.input_files, self.start, self.scoring, self.kept_errors]
        return digest([self.task, data, *faults, *settings, self.repeat, self.threads, self.code])

    @property
    def description(self) -> JobDescription:
        """Names and inputs that the result and the failure of the job state."""
        return JobDescription(
            task=self.task.value,
            source=self.source.name,
            source_sha256=self.source.sha256,
            path=self.source.location,
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
        """Hash of work and data, by which jobs of two suites are paired in a comparison."""
        data = [self.source.kind, *self.source.data_identity]
        faults = [self.faults, effective_seed(self.faults, self.fault_seed)]
        return digest([self.task, *data, *faults, self.repeat, self.start, self.scoring])

    @property
    def group(self) -> GroupKey:
        """Group of the job."""
        return GroupKey(self.task.value, self.configuration, self.alteration)

    @property
    def drive_key(self) -> str:
        """Hash that repeats and copies of one drive share. Their errors are not independent."""
        return digest([self.task, *self.source.drive_identity, self.faults])

    @property
    def drive_order(self) -> DriveOrder:
        """Place of the drive in the order of the drives of its group."""
        return DriveOrder(self.extension, self.drive_key)

    @property
    def measurement(self) -> str:
        """Hash of data, code and parameters, but not of the score settings or of the choice of errors to keep."""
        data = [self.source.kind, self.source.sha256]
        faults = [self.faults, effective_seed(self.faults, self.fault_seed)]
        settings = [self.parameters, self.input_files, self.start]
        return digest([self.task, *data, *faults, *settings, self.repeat, self.code])

    @property
    def alteration(self) -> str:
        """Variant of a budget or faults by which the source was changed; empty if there are none."""
        return self.variant or self.faults

    @property
    def variant(self) -> str:
        """Variant of an error budget; empty without a budget."""
        return self.source.variant if isinstance(self.source, Simulation) else ""

    @property
    def seed(self) -> int:
        """Seed of a simulation; 0 for other sources."""
        return self.source.seed if isinstance(self.source, Simulation) else 0

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
