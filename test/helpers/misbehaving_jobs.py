"""A Dask plugin whose jobs fail as the name of their source states."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

from distributed import WorkerPlugin

from sfr_loc_map.errors import InputError
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.suite.jobs import job_run
from sfr_loc_map.suite.jobs.job import Job


def misbehave(job: Job, scratch: Path, cache: Path) -> Score:
    tried = cache / job.source.name
    with tried.open("a") as stream:
        stream.write("x")
    match job.source.name:
        case "memory":
            held = bytearray(600_000_000)
            held[::4096] = b"1" * len(held[::4096])
            time.sleep(60)
        case "hang":
            time.sleep(60)
        case "crash":
            os.abort()
        case "input":
            raise InputError("no such\ndata set")
        case "fault":
            raise ValueError("odd")
        case "flaky" if tried.stat().st_size < 2:
            os.abort()
    return Score()


class Misbehaving(WorkerPlugin):
    name = "misbehaving"

    def setup(self, worker: Any) -> None:
        job_run.run_job = misbehave
