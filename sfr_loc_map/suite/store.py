"""The folder of a suite. Results are files, from which the state of each job follows.

DIR/plan.json               the plan (`Plan`) with its hash
DIR/results/KEY.json        score of a job (sfr-score/2)
DIR/failures/KEY.json       cause of the failure of a job
DIR/workers.json            workers of the runs: finished jobs, and why a worker was set aside
DIR/suite.json, report.html, pages/, results.parquet
                            the report: a summary of the files above, which is made again from them
DIR/search.json, search.html, case.yaml
                            the result of a search
DIR/cache/                  facts of sources, simulated and fetched sources; may be deleted

Who writes: The process that holds the lock (`Store.locked`) writes all files except the cache. This is
`sfr suite run`, `sfr suite search`, or `sfr suite report`, which writes only the report. Dask workers write no file of
the folder except simulated sources in the cache. They return each outcome to the process that started them. Files of
the cache are complete or absent, so that several processes can write them.
"""

from __future__ import annotations

import fcntl
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from sfr_loc_map.atomic import make_folder, write_text
from sfr_loc_map.errors import ConfigError, InputError, OutputError
from sfr_loc_map.hashes import hash_path
from sfr_loc_map.inputs import MAX_JSON_BYTES, MB, read_text, refusing
from sfr_loc_map.json_yaml import parse_json
from sfr_loc_map.metrics.figures.records import Provenance
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.stored.score_json import HASH, from_dict, from_plain, hash_of_values, json_line, to_plain
from sfr_loc_map.suite.jobs.job import PROVENANCE_PREFIX, Job, JobDescription
from sfr_loc_map.suite.jobs.job_outcome import JobFailure, JobOutcome, JobState, WorkerRecord
from sfr_loc_map.suite.jobs.sources import Estimate
from sfr_loc_map.suite.planning.plan import Plan, PlanOwner
from sfr_loc_map.suite.planning.specification import Refusal

PLAN, WORKERS = "plan.json", "workers.json"
LOCK = ".lock"
ADVICE = "delete this file and run the suite again"
FOLDER_ADVICE = "choose another folder"
T = TypeVar("T")


class StoredResult(msgspec.Struct, frozen=True):
    """The part of a stored result that describes its job."""

    provenance: Provenance | None = None


class Store:
    """The folder of a suite, which the first write creates; raises OutputError if the folder has other content."""

    def __init__(self, folder: Path) -> None:
        self.folder = Path(folder)
        self.results, self.failures, self.cache = (self.folder / name for name in ("results", "failures", "cache"))
        self.plan_file = self.folder / PLAN
        found = [path.name for path in self.folder.iterdir()] if self.folder.is_dir() else []
        others = [name for name in found if name not in (self.cache.name, LOCK)]  # a plan of jobs fills the cache
        if others and not self.plan_file.exists() and not self.results.is_dir():
            raise OutputError(f"'{folder}' contains {others[0]} and is not the folder of a suite: choose another name")
        self._plan: Plan | None = None

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Lock the folder, which only one process may write; raise OutputError if another process has the lock."""
        with self.locked_if_free() as is_locked:
            if not is_locked:
                raise OutputError(f"another run uses '{self.folder}': wait for its end, or stop it")
            yield

    @contextmanager
    def locked_if_free(self) -> Iterator[bool]:
        """Lock the folder unless another process has the lock; yield whether this process has the lock."""
        make_folder(self.cache, FOLDER_ADVICE)  # workers use this cache only if it exists
        with ExitStack() as stack:
            try:
                stream = stack.enter_context((self.folder / LOCK).open("w"))
                fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
                is_locked = True
            except BlockingIOError:
                is_locked = False
            except OSError as error:
                raise OutputError(
                    f"cannot write in '{self.folder}': {error.strerror}; choose another folder"
                ) from error
            yield is_locked

    # ---- the plan

    def save_plan(self, plan: Plan) -> None:
        """Save a plan with the hash of its values; ConfigError if it has so many jobs that it could not be read."""
        content = to_plain(plan)
        text = json_line({**content, HASH: hash_of_values(content)})
        if len(text) > MAX_JSON_BYTES:
            raise ConfigError(f"the plan of {len(plan.jobs)} jobs exceeds {MAX_JSON_BYTES / MB:g} MB: split the suite")
        _write(text, self.plan_file)
        self._plan = plan

    @property
    def plan(self) -> Plan:
        """The saved plan; InputError if the file was written by another version, or was edited."""
        if self._plan is None:
            content = _read(self.plan_file)
            plan = _record(Plan, content, self.plan_file)
            if content.get(HASH) != hash_of_values(content):
                raise InputError(
                    f"'{self.plan_file}' was edited or is of another version, as its {HASH} shows: run the suite again"
                )
            self._plan = plan
        return self._plan

    @property
    def earlier_plan(self) -> Plan | None:
        """The plan of the last run; None if there is none, or if it is of another version or was edited."""
        try:
            return self.plan if self.plan_file.exists() else None
        except InputError:
            return None

    def check_owner(self, file: Path, *, is_search: bool = False) -> None:
        """Raise OutputError if the folder belongs to another file of a suite, or of a search, than the given file.

        If the file that the plan names is missing, for example because it was moved, any file of the same kind is
        accepted. Plans of other versions are accepted, because a run replaces them.
        """
        if not self.plan_file.exists():
            return
        owner = _record(PlanOwner, _read(self.plan_file), self.plan_file)
        if not owner.file:
            return
        owning_file = Path(owner.file)
        is_same_file = not owning_file.exists() or owning_file.resolve() == file.resolve()
        if owner.is_search == is_search and is_same_file:
            return
        kind = "search" if owner.is_search else "suite"
        raise OutputError(f"'{self.folder}' is the folder of the {kind} '{owning_file}': choose another folder")

    def check_files(self) -> None:
        """Raise InputError if the suite's file or the limits file has changed since the plan was made.

        A missing file is accepted, because the plan has what the run has read from it.
        """
        for file in self.plan.files:
            if Path(file.path).is_file() and hash_path(Path(file.path)) != file.sha256:
                raise InputError(f"'{file.path}' has changed since '{self.plan_file}' was written: run the suite again")

    # ---- results and failures

    def left_over(self) -> tuple[Refusal, ...]:
        """Return the sources that have a result or a failure in the folder, but no job of the same work in the plan.

        Without these sources, a suite would count as complete after a bad drive was removed from its file. Results and
        failures of work that is planned with other code, configuration or data are superseded.
        """
        keys = {job.key for job in self.plan.jobs}
        planned: dict[object, set[object]] = {}
        for description in (job.description for job in self.plan.jobs):
            planned.setdefault(description.work, set()).update(description.source_identities)
        found = []
        for path in (*sorted(self.results.glob("*.json")), *sorted(self.failures.glob("*.json"))):
            if path.stem in keys:
                continue
            left = self._description_in(path)
            if planned.get(left.work, set()).isdisjoint(left.source_identities):
                found.append(_left_over(left.source, path))
        return tuple(found)

    def _description_in(self, path: Path) -> JobDescription:
        """Return the description of the job in a result or failure; InputError if the file has none."""
        if path.parent == self.failures:
            return _record(JobFailure, _read(path), path).description
        return _description(_record(StoredResult, _read(path), path).provenance, path)

    def workers(self) -> tuple[WorkerRecord, ...]:
        """Return the workers of all runs."""
        path = self.folder / WORKERS
        return _record(tuple[WorkerRecord, ...], _read(path), path) if path.exists() else ()

    def add_workers(self, records: Sequence[WorkerRecord]) -> None:
        """Add the workers of a run to those of earlier runs."""
        _write(json_line([*self.workers(), *records]), self.folder / WORKERS)

    def state(self, job: Job) -> JobState:
        """Return the state of a job.

        If a job has a failure and a result, the failure is newer, because saving a result deletes the failure.
        """
        name = f"{job.key}.json"
        if (self.failures / name).is_file():
            return JobState.FAILED
        return JobState.DONE if (self.results / name).is_file() else JobState.WAITING

    def score(self, job: Job) -> Score:
        """Return the score of a job.

        InputError if the file has no hash, or if the score is that of another job or of other files.
        """
        path = self.results / f"{job.key}.json"
        content = _read(path)
        score = from_dict(content, f"'{path}'", needs_hash=True, advice=ADVICE)
        description = _description(score.provenance, path)
        if description.key != job.key:
            raise InputError(f"'{path}' is the result of '{description.source}', not of '{job.label}': {ADVICE}")
        inputs = {} if score.provenance is None else score.provenance.inputs
        planned = job.source.input_sha256 if isinstance(job.source, Estimate) else {}
        for role, sha256 in planned.items():
            if role not in inputs or inputs[role].sha256 != sha256:
                raise InputError(f"'{path}': the {role} of '{job.label}' is not the file of the plan: {ADVICE}")
        return score

    def failure(self, job: Job) -> JobFailure:
        """Return the failure of a job, with the names in the plan, because names may have changed since the failure."""
        path = self.failures / f"{job.key}.json"
        stored = _record(JobFailure, _read(path), path)
        return JobFailure.of(job, stored.cause, stored.message)

    def save(self, job: Job, outcome: JobOutcome) -> None:
        """Save the outcome of a job atomically."""
        failed = self.failures / f"{job.key}.json"
        if outcome.cause is None:
            _write(outcome.result or "", self.results / f"{job.key}.json")
            failed.unlink(missing_ok=True)
            return
        _write(json_line(JobFailure.of(job, outcome.cause, outcome.message)), failed)


def _description(provenance: Provenance | None, path: Path) -> JobDescription:
    """Return the description of the job in the provenance of a result; InputError if the result names no job."""
    with refusing(f"cannot read '{path}'", ADVICE):
        description = JobDescription.from_provenance({} if provenance is None else provenance.configuration)
    if not description.key:
        raise InputError(f"'{path}' does not name its job ({PROVENANCE_PREFIX}key in its provenance): {ADVICE}")
    return description


def _left_over(source: str, path: Path) -> Refusal:
    where = f"{path.parent.name}/{path.name}"
    return Refusal(
        source,
        f"'{source}' was run ({where}) but is no longer part of the suite: add it to the suite, or delete this file",
    )


def _write(text: str, path: Path) -> None:
    """Write a file atomically, in a folder that is created if it does not exist."""
    make_folder(path.parent, FOLDER_ADVICE)
    write_text(text, path)


def _record(kind: type[T], value: object, path: Path) -> T:
    """Return the value of a type from the JSON values of a file; InputError if they do not match the type."""
    with refusing(f"cannot read '{path}'", ADVICE):
        return from_plain(kind, value)


def _read(path: Path) -> Any:  # noqa: ANN401 - any JSON
    """Return the JSON values of a file; InputError if the file cannot be read."""
    with refusing(f"cannot read '{path}'", ADVICE):
        return parse_json(read_text(path, MAX_JSON_BYTES))
