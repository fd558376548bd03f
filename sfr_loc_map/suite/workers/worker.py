"""The part of the suite that runs in a Dask worker: its report about its code, and a job with its time limit."""

from __future__ import annotations

import os
import platform
import socket
import tempfile
import threading
import time
from collections.abc import Mapping
from pathlib import Path

from sfr_loc_map import __version__
from sfr_loc_map.errors import SfrError
from sfr_loc_map.message_text import one_line
from sfr_loc_map.suite.jobs.digests import code_facts, code_fingerprint
from sfr_loc_map.suite.jobs.job import Job
from sfr_loc_map.suite.jobs.job_outcome import FailureCause, JobOutcome

OVER_TIME = "sfr-over-time"  #: Topic of the event by which a worker reports a job that exceeds its time limit.


def about_here(expected: Mapping[str, str]) -> dict[str, str]:
    """Return host, version and code of this worker, and the differences from the expected code (`lacks`).

    The keys are fixed, because clients of other versions read them.
    """
    found = code_facts()
    named = {"sfr_loc_map": f"other code: sfr_loc_map {__version__},"}
    differences = [
        f"{named.get(name, name)} {found.get(name)} in place of {value}"
        for name, value in expected.items()
        if found.get(name) != value
    ]
    return {
        "host": socket.gethostname(),
        "version": __version__,
        "python": platform.python_version(),
        "code": code_fingerprint(),
        "lacks": "; ".join(differences),
    }


def run_on_worker(job: Job, timeout_s: float, cache: str) -> JobOutcome:
    """Run a job. An error of sfr_loc_map is returned as an outcome; other errors are raised.

    After the time limit the process kills itself, because a thread cannot be killed.
    """
    from distributed import get_worker

    from sfr_loc_map.metrics.stored.score_json import to_json
    from sfr_loc_map.suite.jobs.job_run import run_job

    worker = get_worker()
    own_cache = Path(cache) if Path(cache).is_dir() else Path(worker.local_directory) / "sfr-cache"

    def end() -> None:
        worker.log_event(OVER_TIME, {"worker": worker.address, "job": job.key, "seconds": timeout_s})
        time.sleep(0.5)  # time to send the event
        os._exit(1)

    timer = threading.Timer(timeout_s, end)
    timer.daemon = True
    timer.start()
    try:
        with tempfile.TemporaryDirectory(dir=worker.local_directory) as scratch:
            return JobOutcome(worker=worker.address, result=to_json(run_job(job, Path(scratch), own_cache)))
    except SfrError as error:
        return JobOutcome(worker=worker.address, cause=FailureCause.of(error), message=one_line(str(error)))
    finally:
        timer.cancel()
