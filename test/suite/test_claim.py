"""A task that two clients ask for is run once; the result is whole or not there."""

from __future__ import annotations

import threading
import time
from dataclasses import replace
from pathlib import Path

import pytest
from test_execution import TASK

from sfr_loc_map.suite import claim
from sfr_loc_map.suite.claim import execute_once, result_path
from sfr_loc_map.suite.execution import Attempt, Bounds, Cause, Outcome

BOUNDS = Bounds(memory_bytes=10**9, timeout_s=10.0)
FAILED = Attempt(cause=Cause.FAULT, message="odd", seconds=1.0, peak_bytes=1)


@pytest.fixture
def runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The results that tasks give, one after the other; an empty one is a failure. What has run is taken off."""
    for name in (claim.RUNNING, claim.RESULTS):
        (tmp_path / name).mkdir()
    texts: list[str] = []

    def execute(task: object, bounds: Bounds, cache: Path, stop: object) -> Outcome:
        time.sleep(0.1)
        text = texts.pop(0)
        failures = () if text else (FAILED,)
        return Outcome(key="k", result=text or None, failures=failures, seconds=0.1, peak_bytes=1, done=bool(text))

    monkeypatch.setattr(claim, "execute", execute)
    monkeypatch.setattr(claim, "ASK_AGAIN_S", 0.01)
    return texts


def together(folder: Path, count: int) -> list[Outcome]:
    outcomes: list[Outcome] = []
    threads = [
        threading.Thread(target=lambda: outcomes.append(execute_once(TASK, BOUNDS, folder, folder)))
        for _ in range(count)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return outcomes


def test_who_comes_second_finds_the_result(runs: list[str], tmp_path: Path) -> None:
    runs += ["first", "second"]
    outcomes = together(tmp_path, 4)
    assert all(outcome.done and outcome.result is None for outcome in outcomes)
    assert sorted(outcome.seconds or 0.0 for outcome in outcomes) == [0.0, 0.0, 0.0, 0.1]
    assert result_path(tmp_path, TASK.key).read_text() == "first"
    assert runs == ["second"]
    assert list((tmp_path / claim.RUNNING).iterdir()) == []


def test_who_comes_second_runs_it_where_the_first_failed(runs: list[str], tmp_path: Path) -> None:
    runs += ["", "second"]
    assert sorted(outcome.done for outcome in together(tmp_path, 2)) == [False, True]
    assert result_path(tmp_path, TASK.key).read_text() == "second"


def test_what_is_asked_for_again_is_run_again(runs: list[str], tmp_path: Path) -> None:
    runs += ["first", "second"]
    for _ in range(2):
        assert execute_once(TASK, replace(BOUNDS, again=True), tmp_path, tmp_path).done
    assert result_path(tmp_path, TASK.key).read_text() == "second"


def test_a_stop_ends_the_wait(runs: list[str], tmp_path: Path) -> None:
    runs.append("first")
    stop = threading.Event()
    stop.set()
    other = threading.Thread(target=lambda: execute_once(TASK, BOUNDS, tmp_path, tmp_path))
    other.start()
    while not list((tmp_path / claim.RUNNING).iterdir()):
        time.sleep(0.001)
    time.sleep(0.02)
    outcome = execute_once(TASK, BOUNDS, tmp_path, tmp_path, stop)
    assert [item.cause for item in outcome.failures] == [Cause.STOPPED]
    other.join()
