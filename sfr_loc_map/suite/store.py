"""The folder of a suite: results, failures, and an index of both.

DIR/results/KEY.json        score of a task (sfr-score/1)
DIR/failures/KEY.json       why a task failed, each try
DIR/index.sqlite            tasks, their state and cost; made again from the files if it is gone
DIR/cache/                  simulated sources, may be deleted
DIR/running/                locks of the tasks that run
DIR/.suite                  the file that was run last
"""

from __future__ import annotations

import fcntl
import json
import os
import shlex
import sqlite3
import time
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

from sfr_loc_map.errors import InputError, OutputError
from sfr_loc_map.io.atomic import atomic_path
from sfr_loc_map.metrics.score_json import RecordError, from_plain, json_line, to_plain
from sfr_loc_map.suite.claim import RESULTS, RUNNING, write_result
from sfr_loc_map.suite.execution import Attempt, Outcome
from sfr_loc_map.suite.fingerprint import FileStamp, SourceFacts, inspect_source
from sfr_loc_map.suite.task import Task

CACHE = "cache"
SUITE_FILE = ".suite"
SHORT_KEY = 12
"""Digits of a key that name a task to people."""
SAVE_EVERY_S = 1.0
_TABLES = """
CREATE TABLE IF NOT EXISTS tasks (
    key TEXT PRIMARY KEY, position INTEGER, label TEXT, kind TEXT, source TEXT, path TEXT, source_sha256 TEXT,
    faults TEXT, configuration TEXT, repeat INTEGER, pairing TEXT, task TEXT, state TEXT, seconds REAL,
    peak_bytes INTEGER, tries INTEGER, cause TEXT, message TEXT);
CREATE TABLE IF NOT EXISTS sources (path TEXT PRIMARY KEY, size INTEGER, mtime_ns INTEGER, facts TEXT);
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Failure:
    """A task that failed.

    Attributes:
        key: Key of the task.
        label: Its name.
        source: Place of its source.
        attempts: Each try.
    """

    key: str
    label: str
    source: str
    attempts: tuple[Attempt, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """A task in the index.

    Attributes:
        task: The task.
        state: `done`, `failed` or `waiting`.
        seconds: How long the last try took, None if it never ran here.
        peak_bytes: Largest resident memory of it.
    """

    task: Task
    state: str
    seconds: float | None
    peak_bytes: int | None


class Store:
    """The folder of a suite."""

    def __init__(self, folder: Path) -> None:
        """Open or make a folder.

        Raises:
            OutputError: If it cannot be made, or holds something else.
        """
        self.folder = Path(folder)
        self.results, self.failures, self.cache = (self.folder / name for name in (RESULTS, "failures", CACHE))
        self._unsaved: list[tuple[object, ...]] = []
        self._saved_s = time.monotonic()
        others = [path.name for path in self.folder.iterdir()] if self.folder.is_dir() else []
        if others and not (self.folder / "index.sqlite").exists() and not self.results.is_dir():
            raise OutputError(f"'{folder}' holds {others[0]} and is not a folder of a suite: choose another name")
        try:
            for path in (self.results, self.failures, self.cache, self.folder / RUNNING):
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
        """Return what a source holds; it is read once as long as its size and time of change stay."""
        stamp = FileStamp.of(path)
        name = str(path.absolute())
        with self._index() as index:
            query = "SELECT facts FROM sources WHERE path = ? AND size = ? AND mtime_ns = ?"
            row = index.execute(query, (name, stamp.size, stamp.mtime_ns)).fetchone()
        if row is not None:
            return from_plain(SourceFacts, json.loads(row[0]))
        facts = inspect_source(path)
        values = (name, stamp.size, stamp.mtime_ns, json.dumps(to_plain(facts)))
        with self._index() as index:
            index.execute("INSERT OR REPLACE INTO sources VALUES (?, ?, ?, ?)", values)
        return facts

    @property
    def suite_file(self) -> str:
        """The file that was run last, empty where this is not known."""
        path = self.folder / SUITE_FILE
        return path.read_text(encoding="utf-8").strip() if path.is_file() else ""

    def command(self, key: str) -> str:
        """Return the command that runs one task again, empty where the suite's file is not known."""
        suite = self.suite_file
        words = ("sfr", "suite", "run", suite, "--out", str(self.folder.absolute()), "--only", key[:SHORT_KEY])
        return shlex.join(words) if suite else ""

    def is_done(self, key: str) -> bool:
        """Tell whether there is a result."""
        return (self.results / f"{key}.json").is_file()

    def has_failed(self, key: str) -> bool:
        """Tell whether there is a failure."""
        return (self.failures / f"{key}.json").is_file()

    def result_text(self, key: str) -> str:
        """Return the score of a task as JSON.

        Raises:
            InputError: If it cannot be read.
        """
        path = self.results / f"{key}.json"
        try:
            return path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(f"cannot read the result '{path}': {error}; delete it and run the suite again") from error

    def failure(self, key: str) -> Failure | None:
        """Return why a task failed, None if it did not."""
        path = self.failures / f"{key}.json"
        if not path.is_file():
            return None
        try:
            return from_plain(Failure, json.loads(path.read_text(encoding="utf-8")))
        except (OSError, ValueError, RecordError) as error:
            raise InputError(f"cannot read '{path}': {error}; delete it and run the suite again") from error

    def plan(self, tasks: Sequence[Task], suite: Path) -> None:
        """Take the tasks of a suite's file as it is now; the state of each follows from the files."""
        (self.folder / SUITE_FILE).write_text(f"{suite.absolute()}\n", encoding="utf-8")
        with self._index() as index:
            costs = {row[0]: row[1:] for row in index.execute("SELECT key, seconds, peak_bytes, tries FROM tasks")}
            index.execute("DELETE FROM tasks")
            for position, task in enumerate(tasks):
                failure = self.failure(task.key)
                last = failure.attempts[-1] if failure is not None else None
                source = task.source
                seconds, peak, tries = costs.get(task.key, (None, None, None))
                index.execute(
                    f"INSERT INTO tasks VALUES ({', '.join('?' * 18)})",
                    (task.key, position, task.label, task.kind.value, source.name, source.path, source.sha256)
                    + (task.faults, task.configuration, task.repeat, task.pairing, json.dumps(to_plain(task)))
                    + (self._state(task.key), seconds, peak, tries)
                    + ((last.cause.value, last.message) if last is not None else (None, None)),
                )

    def save(self, task: Task, outcome: Outcome) -> None:
        """Keep what came of a task; the index takes several at a time."""
        if outcome.result is not None:
            write_result(self.folder, task.key, outcome.result)
        path = self.failures / f"{task.key}.json"
        if outcome.done:
            path.unlink(missing_ok=True)
        else:
            failure = Failure(key=task.key, label=task.label, source=task.source.path, attempts=outcome.failures)
            with atomic_path(path) as temporary:
                temporary.write_text(json_line(failure), encoding="utf-8")
        last = outcome.failures[-1] if not outcome.done else None
        values = (
            "done" if outcome.done else "failed",
            outcome.seconds,
            outcome.peak_bytes,
            len(outcome.failures) + outcome.done,
            None if last is None else last.cause.value,
            None if last is None else last.message,
            task.key,
        )
        self._unsaved.append(values)
        if time.monotonic() - self._saved_s > SAVE_EVERY_S:
            self.flush()

    def flush(self) -> None:
        """Write what the index has not got yet; states are never lost, they follow from the files."""
        with self._index() as index:
            index.executemany(
                "UPDATE tasks SET state = ?, seconds = COALESCE(?, seconds), peak_bytes = COALESCE(?, peak_bytes), "
                "tries = ?, cause = ?, message = ? WHERE key = ?",
                self._unsaved,
            )
        self._unsaved, self._saved_s = [], time.monotonic()

    def entries(self) -> list[Entry]:
        """Return the tasks of the suite, in its order."""
        with self._index() as index:
            rows = index.execute("SELECT task, state, seconds, peak_bytes FROM tasks ORDER BY position").fetchall()
        return [
            Entry(task=from_plain(Task, json.loads(row[0])), state=row[1], seconds=row[2], peak_bytes=row[3])
            for row in rows
        ]

    def _state(self, key: str) -> str:
        return "done" if self.is_done(key) else "failed" if self.has_failed(key) else "waiting"

    @contextmanager
    def _index(self) -> Iterator[sqlite3.Connection]:
        path = self.folder / "index.sqlite"
        try:
            with closing(sqlite3.connect(path, timeout=30.0)) as connection, connection:
                yield connection
        except sqlite3.DatabaseError as error:
            raise InputError(f"cannot use '{path}': {error}; delete it, it is made again from the results") from error


def available_cores() -> int:
    """Return the processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
