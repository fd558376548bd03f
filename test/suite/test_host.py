"""A timed task has its host for itself, and gets its turn."""

from __future__ import annotations

import tempfile
import threading
import time
from pathlib import Path

import pytest

from sfr_loc_map.suite import host
from sfr_loc_map.suite.host import host_share


@pytest.fixture(autouse=True)
def own_host(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Locks of this test alone."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(host, "ASK_AGAIN_S", 0.005)


def begin(name: str, told: list[str], leave: threading.Event, *, alone: bool) -> threading.Thread:
    def run() -> None:
        with host_share(alone=alone, stop=threading.Event()) as free:
            assert free
            told.append(name)
            leave.wait()
            told.append(f"end of {name}")

    thread = threading.Thread(target=run)
    thread.start()
    return thread


def wait_for(told: list[str], count: int) -> None:
    end = time.monotonic() + 20.0
    while len(told) < count and time.monotonic() < end:
        time.sleep(0.002)


def test_others_run_side_by_side_and_a_timed_task_between_them() -> None:
    told: list[str] = []
    first, second, third = (threading.Event() for _ in range(3))
    threads = [begin("a", told, first, alone=False), begin("b", told, first, alone=False)]
    wait_for(told, 2)
    threads.append(begin("timed", told, second, alone=True))
    time.sleep(0.05)
    threads.append(begin("late", told, third, alone=False))
    time.sleep(0.05)
    assert sorted(told) == ["a", "b"]
    first.set()
    wait_for(told, 5)
    time.sleep(0.05)
    assert told[4:] == ["timed"]
    second.set()
    third.set()
    for thread in threads:
        thread.join()
    assert told[4:] == ["timed", "end of timed", "late", "end of late"]


def test_a_stop_ends_the_wait() -> None:
    leave, stop, told = threading.Event(), threading.Event(), []
    thread = begin("timed", told, leave, alone=True)
    wait_for(told, 1)
    stop.set()
    with host_share(alone=False, stop=stop) as free:
        assert not free
    leave.set()
    thread.join()
