"""The folder of a suite: results, failures, and an index of both.

DIR/results/KEY.json        score of a job (sfr-score/1)
DIR/failures/KEY.json       why a job failed
DIR/index.sqlite            jobs with their state and time; made again from the files if it is gone
DIR/cache/                  simulated and fetched sources, may be deleted
DIR/.suite                  the file that was run last
"""

from __future__ import annotations

import fcntl
import json
import shlex
import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from sfr_loc_map.errors import InputError, OutputError
from sfr_loc_map.io.atomic import atomic_path
from sfr_loc_map.metrics.score_json import RecordError, from_plain, json_line, to_plain
from sfr_loc_map.suite.cluster import FailureCause, JobOutcome
from sfr_loc_map.suite.job import SHORT_KEY, Job
from sfr_loc_map.suite.plan import SourceFacts, inspect_source

SUITE_FILE = ".suite"
_TABLES = """
CREATE TABLE IF NOT EXISTS tasks (
    key TEXT PRIMARY KEY, position INTEGER, label TEXT, kind TEXT, source TEXT, path TEXT, source_sha256 TEXT,
    faults TEXT, configuration TEXT, repeat INTEGER, pairing TEXT, task TEXT, state TEXT, seconds REAL, tries INTEGER,
    cause TEXT, message TEXT);
CREATE TABLE IF NOT EXISTS sources (path TEXT PRIMARY KEY, size INTEGER, mtime_ns INTEGER, facts TEXT);
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class JobFailure:
    """A job that failed, and why."""

    key: str
    label: str
    source: str  #: Place of its source.
    cause: FailureCause
    message: str
    tries: int
    again: str = ""  #: Command that runs it again, alone; empty where the suite's file is not known.


class Store:
    """The folder of a suite."""

    def __init__(self, folder: Path) -> None:
        """Open or make a folder.

        Raises:
            OutputError: If it cannot be made, or holds something else.
        """
        self.folder = Path(folder)
        self.results, self.failures, self.cache = (self.folder / name for name in ("results", "failures", "cache"))
        others = [path.name for path in self.folder.iterdir()] if self.folder.is_dir() else []
        if others and not (self.folder / "index.sqlite").exists() and not self.results.is_dir():
            raise OutputError(f"'{folder}' holds {others[0]} and is not a folder of a suite: choose another name")
        try:
            for path in (self.results, self.failures, self.cache):
                path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(f"cannot make the folder '{folder}': {error.strerror}; check the rights") from error
        with self._index() as index:
            index.executescript(_TABLES)

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Hold the folder for one run at a time.

        Raises:
            OutputError: If another run holds it.
        """
        with (self.folder / ".lock").open("w") as stream:
            try:
                fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                raise OutputError(f"another run works in '{self.folder}': wait for its end, or end it") from error
            yield

    def facts_of(self, path: Path) -> SourceFacts:
        """Return what a source holds; it is read once as long as its size and time of change stay.

        Raises:
            InputError: If it cannot be read.
        """
        try:
            files = [path] if path.is_file() else [item for item in path.rglob("*") if item.is_file()]
            stats = [item.stat() for item in files]
        except OSError as error:
            raise InputError(f"cannot read '{error.filename}': {error.strerror}; check the rights") from error
        newest = max((item.st_mtime_ns for item in stats), default=0)
        stamp = (str(path.absolute()), sum(item.st_size for item in stats), newest)
        with self._index() as index:
            query = "SELECT facts FROM sources WHERE path = ? AND size = ? AND mtime_ns = ?"
            row = index.execute(query, stamp).fetchone()
        if row is not None:
            return from_plain(SourceFacts, json.loads(row[0]))
        facts = inspect_source(path)
        with self._index() as index:
            index.execute("INSERT OR REPLACE INTO sources VALUES (?, ?, ?, ?)", (*stamp, json.dumps(to_plain(facts))))
        return facts

    def is_done(self, key: str) -> bool:
        """Tell whether there is a result."""
        return (self.results / f"{key}.json").is_file()

    def has_failed(self, key: str) -> bool:
        """Tell whether there is a failure."""
        return (self.failures / f"{key}.json").is_file()

    def result_text(self, key: str) -> str:
        """Return the score of a job as JSON.

        Raises:
            InputError: If it cannot be read.
        """
        path = self.results / f"{key}.json"
        try:
            return path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(f"cannot read the result '{path}': {error}; delete it and run the suite again") from error

    def failure(self, key: str) -> JobFailure | None:
        """Return why a job failed, None if it did not.

        Raises:
            InputError: If its file cannot be read.
        """
        path, suite = self.failures / f"{key}.json", self.folder / SUITE_FILE
        if not path.is_file():
            return None
        try:
            failure = from_plain(JobFailure, json.loads(path.read_text(encoding="utf-8")))
        except (OSError, ValueError, RecordError) as error:
            raise InputError(f"cannot read '{path}': {error}; delete it and run the suite again") from error
        if suite.is_file():
            words = ("sfr", "suite", "run", suite.read_text(encoding="utf-8").strip(), "--out")
            again = shlex.join((*words, str(self.folder.absolute()), "--only", key[:SHORT_KEY]))
            failure = replace(failure, again=again)
        return failure

    def plan(self, jobs: Sequence[Job], suite: Path) -> None:
        """Take the jobs of a suite's file as it is now; the state of each follows from the files."""
        (self.folder / SUITE_FILE).write_text(f"{suite.absolute()}\n", encoding="utf-8")
        with self._index() as index:
            costs = {row[0]: row[1:] for row in index.execute("SELECT key, seconds, tries FROM tasks")}
            index.execute("DELETE FROM tasks")
            for position, job in enumerate(jobs):
                source, failure = job.source, self.failure(job.key)
                seconds, tries = costs.get(job.key, (None, None))
                row = {
                    "key": job.key,
                    "position": position,
                    "label": job.label,
                    "kind": job.kind.value,
                    "source": source.name,
                    "path": source.path,
                    "source_sha256": source.sha256,
                    "faults": job.faults,
                    "configuration": job.configuration,
                    "repeat": job.repeat,
                    "pairing": job.pairing,
                    "task": json.dumps(to_plain(job)),
                    "state": "done" if self.is_done(job.key) else "waiting" if failure is None else "failed",
                    "seconds": seconds,
                    "tries": tries,
                    "cause": None if failure is None else failure.cause.value,
                    "message": None if failure is None else failure.message,
                }
                places = ", ".join(f":{name}" for name in row)
                index.execute(f"INSERT INTO tasks ({', '.join(row)}) VALUES ({places})", row)

    def save(self, job: Job, outcome: JobOutcome) -> None:
        """Keep what came of a job, whole or not at all.

        Raises:
            OutputError: If it cannot be written.
        """
        key, failed = job.key, self.failures / f"{job.key}.json"
        if outcome.result is not None:
            with atomic_path(self.results / f"{key}.json") as temporary:
                temporary.write_text(outcome.result, encoding="utf-8")
            failed.unlink(missing_ok=True)
        else:
            assert outcome.cause is not None
            failure = JobFailure(
                key=key,
                label=job.label,
                source=job.source.path,
                cause=outcome.cause,
                message=outcome.message,
                tries=outcome.tries,
            )
            with atomic_path(failed) as temporary:
                temporary.write_text(json_line(failure), encoding="utf-8")
        cause = None if outcome.cause is None else outcome.cause.value
        with self._index() as index:
            index.execute("PRAGMA synchronous = OFF")  # a lost row is made again from the files
            index.execute(
                "UPDATE tasks SET state = ?, seconds = COALESCE(?, seconds), tries = ?, cause = ?, message = ? "
                "WHERE key = ?",
                ("failed" if cause else "done", outcome.seconds, outcome.tries, cause, outcome.message or None, key),
            )

    def entries(self) -> list[tuple[Job, str, float | None]]:
        """Return the jobs of the suite in its order, each with `done`, `failed` or `waiting`, and how long it took."""
        with self._index() as index:
            rows = index.execute("SELECT task, state, seconds FROM tasks ORDER BY position").fetchall()
        return [(from_plain(Job, json.loads(job)), state, seconds) for job, state, seconds in rows]

    @contextmanager
    def _index(self) -> Iterator[sqlite3.Connection]:
        path = self.folder / "index.sqlite"
        try:
            with closing(sqlite3.connect(path, timeout=30.0)) as connection, connection:
                yield connection
        except sqlite3.DatabaseError as error:
            raise InputError(f"cannot use '{path}': {error}; delete it, it is made again from the results") from error
