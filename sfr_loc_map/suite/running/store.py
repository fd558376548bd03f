"""The folder of a suite. Its results are files, and what is done follows from them.

DIR/results/KEY.json        score of a job (sfr-score/2)
DIR/failures/KEY.json       why a job failed
DIR/plan.json               what the sources of the suite's file hold, its jobs in their order, its limits, its code;
                            path and hash of that file and of the file of the limits
DIR/workers.json            the workers of its runs, what they did, why they were set aside
DIR/cache/                  simulated and fetched sources, may be deleted
"""

from __future__ import annotations

import fcntl
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from sfr_loc_map.atomic import write_text
from sfr_loc_map.errors import InputError, OutputError
from sfr_loc_map.inputs import hash_path, refusing
from sfr_loc_map.metrics.judging.limits_file import parse_limits
from sfr_loc_map.metrics.limits import Limits
from sfr_loc_map.metrics.score import Score
from sfr_loc_map.metrics.score_json import from_dict, from_plain, json_line, to_plain
from sfr_loc_map.suite.running.digests import file_state
from sfr_loc_map.suite.running.job import FailureCause, Job, JobOutcome, WorkerRecord
from sfr_loc_map.suite.running.plan import SourceFacts, inspect_source
from sfr_loc_map.suite.running.provenance import about_run
from sfr_loc_map.suite.running.specification import Refusal, limits_in

PLAN, WORKERS = "plan.json", "workers.json"
ADVICE = "delete it and run the suite again"
WORK = ("task", "source", "faults", "fault_seed", "repeat")  #: Keys of a result's provenance that name its work.
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class JobFailure:
    """A job that failed, and why."""

    key: str
    label: str
    source: str  #: Place of its source.
    cause: FailureCause
    message: str
    configuration: str = ""
    pairing: str = ""  #: What it has in common with the same job of other suites.


class Store:
    """The folder of a suite: opened, or made; OutputError if it holds something else."""

    def __init__(self, folder: Path) -> None:
        self.folder = Path(folder)
        self.results, self.failures, self.cache = (self.folder / name for name in ("results", "failures", "cache"))
        plan = self.folder / PLAN
        others = [path.name for path in self.folder.iterdir()] if self.folder.is_dir() else []
        if others and not plan.exists() and not self.results.is_dir():
            raise OutputError(f"'{folder}' holds {others[0]} and is not a folder of a suite: choose another name")
        try:
            for path in (self.results, self.failures, self.cache):
                path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(f"cannot make the folder '{folder}': {error.strerror}; check the permissions") from error
        self._plan: dict[str, Any] = {"sources": {}, "jobs": [], "limits": {}, "refusals": [], "run": {}, "files": []}
        if plan.exists():
            found = _read(plan)
            if not isinstance(found, dict) or any(type(found.get(k, v)) is not type(v) for k, v in self._plan.items()):
                raise InputError(f"'{plan}' is not the plan of a suite: run the suite again in another folder")
            self._plan |= found
        self._jobs: tuple[Job, ...] | None = None

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Hold the folder for one run at a time."""
        try:
            stream = (self.folder / ".lock").open("w")
        except OSError as error:
            raise OutputError(f"cannot write in '{self.folder}': {error.strerror}; choose another folder") from error
        with stream:
            try:
                fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                raise OutputError(f"another run works in '{self.folder}': wait for its end, or end it") from error
            yield

    def facts_of(self, path: Path) -> SourceFacts:
        """Return what a source holds; it is read once as long as its `file_state` stays."""
        state = file_state(path)
        known = self._plan["sources"].get(str(path.absolute()))
        if known is not None and known["stamp"] == state:
            return _record(SourceFacts, known["facts"], self.folder / PLAN)
        facts = inspect_source(path)
        self._plan["sources"][str(path.absolute())] = {"stamp": state, "facts": to_plain(facts)}
        return facts

    def plan(
        self,
        jobs: Sequence[Job],
        refusals: Sequence[Refusal] = (),
        limits: Mapping[str, object] = {},
        files: Sequence[Path] = (),
    ) -> None:
        """Take the jobs and limits of a suite's file as it is now, and the sources that it cannot read.

        `files` are the suite's file and, if its limits have one of their own, that file.
        """
        self._plan |= {
            "files": [{"path": str(path.absolute()), "sha256": hash_path(path)} for path in files],
            "jobs": to_plain(jobs),
            "limits": to_plain(limits),
            "refusals": to_plain(refusals),
            "run": about_run(),
        }
        write_text(json_line(self._plan), self.folder / PLAN)
        self._jobs = None

    def check_files(self) -> tuple[str, ...]:
        """Compare the plan with the files that it was made of; return those that are not there.

        InputError if a file has changed, or if the limits of the plan are not those of the suite's file.
        """
        plan = self.folder / PLAN
        absent = []
        for item in self._plan["files"]:
            path = Path(item["path"])
            if not path.is_file():
                absent.append(str(path))
            elif hash_path(path) != item["sha256"]:
                raise InputError(f"'{path}' has changed since '{plan}' was made of it: run the suite again")
        if self._plan["files"] and not absent:
            suite = Path(self._plan["files"][0]["path"])
            if to_plain(limits_in(suite)) != self._plan["limits"]:
                raise InputError(f"'{plan}' has other limits than '{suite}': run the suite again")
        return tuple(absent)

    @property
    def run(self) -> dict[str, Any]:
        """By which code, where and when it was run last."""
        return dict(self._plan["run"])

    @property
    def limits(self) -> Limits | None:
        """Limits of the suite's verdicts, None for none."""
        limits = self._plan["limits"]
        return parse_limits(limits, f"'{self.folder / PLAN}': limits") if limits else None

    @property
    def refusals(self) -> tuple[Refusal, ...]:
        """Sources that could not be read when it was run last, and those that left results but are of no task now."""
        unread = (_record(Refusal, item, self.folder / PLAN) for item in self._plan["refusals"])
        return (*unread, *self.left_over())

    def left_over(self) -> tuple[Refusal, ...]:
        """Return the sources that have a result or a failure in the folder, but no task of the same kind in the plan.

        A suite without its bad drive would otherwise be complete. Results of a source that is run again with other
        code, another configuration or other data are superseded. A source is the same one if its path or its data are:
        another source may have the same name.
        """
        keys = {job.key for job in self.jobs}
        planned: dict[object, set[object]] = {}
        for job in self.jobs:
            work = _work(job.kind.value, job.source.name, job.faults, job.fault_seed, job.repeat)
            planned.setdefault(work, set()).update((self._place(job.source.path), job.source.sha256))
        paths = {job.source.path for job in self.jobs}
        found = []
        for path in sorted(path for path in self.results.glob("*.json") if path.stem not in keys):
            about = _read(path).get("provenance", {}).get("configuration", {})
            same = planned.get(_work(*(about.get(f"suite.{name}") for name in WORK)), set())
            if same.isdisjoint((self._place(str(about.get("suite.path"))), about.get("suite.source_sha256"))):
                found.append(_left_over(str(about.get("suite.source")), path))
        for path in sorted(path for path in self.failures.glob("*.json") if path.stem not in keys):
            failure = self.failure(path.stem)
            if failure.source not in paths:
                found.append(_left_over(failure.source, path))
        return tuple(found)

    def _place(self, path: str) -> str:
        """Return the path of a source; of a fetched source, whose folder is named after its version, the name alone."""
        return Path(path).name if self.cache.absolute() in Path(path).parents else path

    def workers(self) -> tuple[WorkerRecord, ...]:
        """Return the workers of all its runs."""
        path = self.folder / WORKERS
        return tuple(_record(WorkerRecord, item, path) for item in (_read(path) if path.exists() else ()))

    def add_workers(self, records: Sequence[WorkerRecord]) -> None:
        """Keep the workers of a run beside those of the runs before."""
        write_text(json_line([*self.workers(), *records]), self.folder / WORKERS)

    def state(self, key: str) -> str:
        """Return `failed` if there is a failure, which is later than a result, else `done` or `waiting`."""
        if (self.failures / f"{key}.json").is_file():
            return "failed"
        return "done" if (self.results / f"{key}.json").is_file() else "waiting"

    def score(self, job: Job) -> Score:
        """Return the score of a job; InputError if the file has the score of another job."""
        path = self.results / f"{job.key}.json"
        score = from_dict(_read(path), f"'{path}'")
        about = {} if score.provenance is None else score.provenance.configuration
        if "suite.key" not in about:
            raise InputError(f"'{path}' does not name its job (suite.key in its provenance): {ADVICE}")
        if about["suite.key"] != job.key:
            raise InputError(f"'{path}' is the result of '{about.get('suite.source')}', not of '{job.label}': {ADVICE}")
        return score

    def failure(self, key: str) -> JobFailure:
        """Return why a job failed."""
        path = self.failures / f"{key}.json"
        return _record(JobFailure, _read(path), path)

    def save(self, job: Job, outcome: JobOutcome) -> None:
        """Keep what came of a job, whole or not at all."""
        failed = self.failures / f"{job.key}.json"
        if outcome.cause is None:
            write_text(outcome.result or "", self.results / f"{job.key}.json")
            failed.unlink(missing_ok=True)
            return
        what = (job.key, job.label, job.source.path, outcome.cause, outcome.message, job.configuration, job.pairing)
        write_text(json_line(JobFailure(*what)), failed)

    @property
    def jobs(self) -> tuple[Job, ...]:
        """The jobs of the suite, in its order."""
        if self._jobs is None:
            self._jobs = tuple(_record(Job, item, self.folder / PLAN) for item in self._plan["jobs"])
        return self._jobs


def _work(task: object, source: object, faults: object, fault_seed: object, repeat: object) -> tuple[object, ...]:
    """Return what is done with which source; without faults their seed changes nothing."""
    return (task, source, faults, fault_seed if faults else 0, repeat)


def _left_over(source: str, path: Path) -> Refusal:
    where = f"{path.parent.name}/{path.name}"
    return Refusal(
        source, f"'{source}' was run ({where}) and is in no task now: add it to the suite, or delete that file"
    )


def _record(kind: type[T], value: object, path: Path) -> T:
    with refusing(f"cannot read '{path}'", ADVICE):
        return from_plain(kind, value)


def _read(path: Path) -> Any:  # noqa: ANN401 - any JSON
    with refusing(f"cannot read '{path}'", ADVICE):
        return json.loads(path.read_text(encoding="utf-8"))
