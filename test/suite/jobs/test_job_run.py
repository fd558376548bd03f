"""The work of a job: options of a replay, and threads."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numba
import pytest

from helpers.made_suites import JOB, recording
from sfr_loc_map.errors import InputError, NodeError, SfrError
from sfr_loc_map.metrics.figures.subjects import LimitSection
from sfr_loc_map.metrics.judging.limits_file import load_limits, parse_limits
from sfr_loc_map.metrics.score.limits import LIMITED_NUMBERS
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.stored.score_json import to_json
from sfr_loc_map.suite.jobs import job_run
from sfr_loc_map.suite.jobs.job import JobTask
from sfr_loc_map.suite.jobs.job_run import replay_options, run_job, use_threads

REPLAY = replace(JOB, task=JobTask.REPLAY, threads=3)
BOUNDS = [name for name, item in LIMITED_NUMBERS[LimitSection.TRAJECTORY].items() if item.statistic == "bound"]


@pytest.fixture
def threads_restored() -> Iterator[None]:
    """Restore the threads of this process."""
    before = numba.get_num_threads(), cv2.getNumThreads()
    yield
    numba.set_num_threads(before[0])
    cv2.setNumThreads(before[1])


@pytest.mark.parametrize("bound", BOUNDS)
def test_a_replay_keeps_the_errors_of_figures_with_a_limited_bound(bound: str, tmp_path: Path) -> None:
    terms = {"limit": 0.1, "prob": 0.95, "confidence": 0.95, "interpretation": "ensemble"}
    limits = parse_limits({"trajectory": [{"condition": "distance=1", bound: terms}]}, "limits")
    kept = limits.bounded_figures
    assert kept
    options = replay_options(replace(REPLAY, kept_errors=tuple(kept)), tmp_path)
    given = load_limits(Path(options[options.index("--limits") + 1]))
    assert given.bounded_figures == kept
    assert "--limits" not in replay_options(REPLAY, tmp_path)


def test_a_job_has_its_threads_after_a_job_with_fewer(threads_restored: None) -> None:
    most = numba.config.NUMBA_NUM_THREADS
    for count in (1, most, most + 1):
        use_threads(count)
        assert (numba.get_num_threads(), cv2.getNumThreads()) == (min(count, most), count)


def test_a_replay_runs_with_the_threads_of_the_job(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, threads_restored: None
) -> None:
    given: dict[str, str] = {}

    def no_replay(*_: object, env: dict[str, str], **__: object) -> None:
        given.update(env)
        raise InterruptedError

    monkeypatch.setattr(job_run.subprocess, "run", no_replay)
    with pytest.raises(InterruptedError):
        run_job(replace(REPLAY, source=recording(path=str(tmp_path))), tmp_path, tmp_path)
    names = ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "OPENCV_FOR_THREADS_NUM")
    assert {name: given[name] for name in names} == dict.fromkeys(names, "3")


@pytest.mark.parametrize("has_report", [False, True])
@pytest.mark.parametrize(
    ("code", "error"),
    [(0, None), (1, None), (3, None), (2, InputError), (130, NodeError), (-11, NodeError), (-9, NodeError)],
)
def test_a_replay_is_a_failure_by_the_exit_code_of_its_process(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    threads_restored: None,
    code: int,
    error: type[SfrError] | None,
    has_report: bool,
) -> None:
    """A crash is not bad input, which a search would skip for ever. An interrupted replay is scored in part."""

    def ended(command: list[str], **_: object) -> subprocess.CompletedProcess[str]:
        if has_report:
            folder = Path(command[command.index("--out") + 1])
            folder.mkdir()
            (folder / "report.json").write_text(to_json(Score(figures=())))
        return subprocess.CompletedProcess(command, code, "", "starting\nsfr: the last words\n")

    monkeypatch.setattr(job_run.subprocess, "run", ended)
    job = replace(REPLAY, source=recording(path=str(tmp_path / "drive")))
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    if error is None and has_report:
        assert run_job(job, scratch, tmp_path).figures == ()
        return
    with pytest.raises(error or NodeError, match=r"/drive' .* without a score: sfr: the last words"):
        run_job(job, scratch, tmp_path)
