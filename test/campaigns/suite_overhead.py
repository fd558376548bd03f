"""Overhead of a suite per task (processes, hashes of data, results), and idle time of the workers between tasks.

python -m campaigns suite-overhead [--tasks 1000] [--seconds 0.5] [--long 40] [--megabytes 20]

Tasks sleep for a known time and record when they begin and end. The time between two tasks is overhead.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from distributed import WorkerPlugin

from helpers.made_suites import JOB, recording
from sfr_loc_map.hashes import hash_path
from sfr_loc_map.suite.jobs import job_run
from sfr_loc_map.suite.jobs.digests import code_fingerprint
from sfr_loc_map.suite.jobs.job import Job
from sfr_loc_map.suite.planning.specification import SuiteSettings
from sfr_loc_map.suite.workers.cluster import SuiteWorkers, connected, run_jobs

WORKERS = 2


class Sleeping(WorkerPlugin):
    """Makes jobs sleep for the seconds in their configuration, and record begin and end."""

    name = "sleeping"

    def setup(self, worker: Any) -> None:
        def sleep(job: Job, scratch: Path, cache: Path) -> dict[str, object]:
            begun = time.monotonic()
            time.sleep(float(job.configuration))
            with (cache / f"{os.getpid()}.times").open("a") as stream:
                stream.write(f"{begun} {time.monotonic()}\n")
            return {}

        job_run.run_job = sleep  # type: ignore[assignment]


def measured(name: str, tasks: int, seconds: float, sources: list[Path], folder: Path) -> float:
    """Run tasks on two workers; print and return the fraction of time in which workers were idle."""
    folder.mkdir()
    code = code_fingerprint()
    known = {path: hash_path(path) for path in sources}
    jobs = [
        replace(
            JOB,
            source=recording(sha256=known[path], path=str(path)),
            configuration=str(seconds),
            repeat=number,
            code=code,
        )
        for number in range(tasks)
        for path in [sources[number % len(sources)]]
    ]
    settings = SuiteSettings(timeout_s=60.0, wait_s=60.0)
    with connected(settings, workers=WORKERS, scheduler=None) as client:
        client.register_plugin(Sleeping())
        at_work = SuiteWorkers(client, settings, print)
        begun = time.monotonic()
        done = sum(outcome.cause is None for _, outcome in run_jobs(jobs, at_work, folder))
        wall = time.monotonic() - begun
    gaps = defaultdict[str, list[float]](list)
    slept, span = 0.0, 0.0
    for path in folder.glob("*.times"):
        rows = np.loadtxt(path, ndmin=2)
        gaps[path.name] = list(rows[1:, 0] - rows[:-1, 1])
        slept, span = slept + float((rows[:, 1] - rows[:, 0]).sum()), span + float(rows[-1, 1] - rows[0, 0])
    every = np.array([gap for row in gaps.values() for gap in row])
    share = float(every.sum() / span)
    print(
        f"{name}: {done} of {tasks} tasks of {seconds:g} s, wall {wall:.1f} s for {tasks * seconds / WORKERS:.1f} s; "
        f"between two tasks of a worker: median {1e3 * np.median(every):.1f} ms, p99 "
        f"{1e3 * np.quantile(every, 0.99):.1f} ms, "
        f"{100 * share:.2f} % of the time; load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores",
        flush=True,
    )
    return share


def main(arguments: list[str]) -> int:
    """Measure both cases; exit code 1 above 1 % with tasks of 5 s, or above 2 % with many short tasks."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tasks", type=int, default=1000)
    parser.add_argument("--seconds", type=float, default=0.5)
    parser.add_argument("--long", type=int, default=40, help="number of tasks of 5 s, each with its own data")
    parser.add_argument("--megabytes", type=int, default=20, help="size of the data of each such task")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory(prefix="sfr_overhead.") as name:
        folder = Path(name)
        for number in range(options.long):
            (folder / f"drive{number}").write_bytes(os.urandom(options.megabytes * 10**6))
        sources = sorted(folder.glob("drive*"))
        long = measured("new data each", options.long, 5.0, sources, folder / "long")
        short = measured("many", options.tasks, options.seconds, sources[:1], folder / "short")
    return int(long > 0.01 or short > 0.02)
