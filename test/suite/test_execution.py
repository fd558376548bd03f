"""A task that eats memory, hangs, crashes or has bad input fails alone, in its limit, with its cause."""

from __future__ import annotations

import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from sfr_loc_map.suite import execution
from sfr_loc_map.suite.execution import Bounds, Cause, Outcome, execute
from sfr_loc_map.suite.task import Scoring, SourceKind, Task, TaskKind, TaskSource

TASK = Task(
    kind=TaskKind.SCORE,
    source=TaskSource(name="a", kind=SourceKind.ESTIMATE, path="a.csv", truth="b.csv", sha256="0"),
    fault_seed=0,
    configuration="-",
    start="truth",
    scoring=Scoring(conditions=("distance=5",), spacing=10, rebase="pose"),
    repeat=0,
    alone=False,
    threads=1,
    code="c",
)
BEHAVIOUR = {
    "memory": "x = bytearray(900_000_000); import time; time.sleep(60)",
    "hang": "import subprocess, sys; "
    "subprocess.run([sys.executable, '-c', 'import time; time.sleep(61)'], start_new_session=True)",
    "crash": "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)",
    "input": "import sys; print('no such\\ndata set', file=sys.stderr); sys.exit(2)",
    "fault": "print(1); raise ValueError('odd')",
    "flaky": "import os, sys, pathlib; p = pathlib.Path(sys.argv[3]) / 'n'; n = p.stat().st_size if p.exists() else 0; "
    "p.open('a').write('x'); pathlib.Path(sys.argv[2]).write_text('{}') if n == 2 else os.abort()",
}


def run(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch, stop: threading.Event | None = None) -> Outcome:
    script = folder / "script.py"
    script.write_text(BEHAVIOUR[name])
    monkeypatch.setattr(execution, "INSTEAD", str(script))
    return execute(TASK, Bounds(memory_bytes=600_000_000, timeout_s=1.5), folder, stop)


@pytest.fixture(scope="module", autouse=True)
def fork_server() -> Iterator[None]:
    """Start it before any time is taken; end it with the module."""
    with pytest.MonkeyPatch.context() as patch, tempfile.TemporaryDirectory() as folder:
        run("fault", Path(folder), patch)
    yield
    execution.close_fork_server()


@pytest.mark.parametrize(
    ("name", "cause", "tries", "words"),
    [
        ("memory", Cause.MEMORY, 3, "the limit is 600 MB"),
        ("hang", Cause.TIME, 3, "not done after 1.5 s"),
        ("crash", Cause.SIGNAL, 3, "SIGSEGV"),
        ("input", Cause.BAD_INPUT, 1, "data set"),
        ("fault", Cause.FAULT, 3, "ValueError: odd"),
    ],
)
def test_each_fails_for_its_cause(
    name: str, cause: Cause, tries: int, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    outcome = run(name, tmp_path, monkeypatch)
    assert not outcome.done
    assert outcome.result is None
    assert [item.cause for item in outcome.failures] == [cause] * tries
    assert words in outcome.failures[-1].message
    left = [p for p in psutil.process_iter(["cmdline"]) if any("sleep(61)" in part for part in p.info["cmdline"] or [])]
    assert left == []


def test_the_third_try_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    outcome = run("flaky", tmp_path, monkeypatch)
    assert (outcome.done, outcome.result) == (True, "{}")
    assert [item.cause for item in outcome.failures] == [Cause.SIGNAL] * 2


def test_a_stop_ends_it_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stop = threading.Event()
    threading.Timer(0.3, stop.set).start()
    begin = time.monotonic()
    outcome = run("hang", tmp_path, monkeypatch, stop)
    assert time.monotonic() - begin < 1.4
    assert [item.cause for item in outcome.failures] == [Cause.STOPPED]
