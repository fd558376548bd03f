"""Rendering of jobs in several processes."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from functools import cache
from pathlib import Path

from sfr_loc_map.child_process import end_with_parent
from sfr_loc_map.errors import OutputError
from sfr_loc_map.signals import deferred_signals
from sfr_loc_map.simulation.config import SimulationConfig
from sfr_loc_map.simulation.jobs import RenderJob, write_job
from sfr_loc_map.simulation.plan import Plan
from sfr_loc_map.simulation.world import World


def write_jobs(
    config: SimulationConfig, out: Path, jobs: Sequence[RenderJob], workers: int, progress: Callable[[int], None]
) -> None:
    """Write the files of jobs in `workers` processes; OutputError if a process is killed or lacks memory.

    `progress` is called with the number of finished jobs.
    """
    context = multiprocessing.get_context("spawn")
    others = set(multiprocessing.active_children())
    with deferred_signals():  # a signal may go to the whole process group; this process ends the others
        pool = ProcessPoolExecutor(min(workers, len(jobs)), context, _start_worker)
    try:
        with deferred_signals():
            futures = [pool.submit(_write_on_worker, config, out, job) for job in jobs]
        for done, future in enumerate(as_completed(futures), start=1):
            future.result()
            progress(done)
    except KeyboardInterrupt:  # an unfinished job may take 30 s, and is rendered again anyway
        for worker in set(multiprocessing.active_children()) - others:
            worker.kill()
        raise
    except (BrokenProcessPool, MemoryError) as error:
        raise OutputError(
            "a worker process was killed or has no memory: run the command again with fewer --workers to continue"
        ) from error
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _start_worker() -> None:
    """Let a worker process end with its parent."""
    end_with_parent(signal.SIGKILL)
    if (parent := multiprocessing.parent_process()) is None or not parent.is_alive():  # parent killed before the call
        os._exit(1)


def _write_on_worker(config: SimulationConfig, out: Path, job: RenderJob) -> None:
    """Write the files of a job in a worker process."""
    write_job(_world_of(config), out, job)


@cache
def _world_of(config: SimulationConfig) -> World:
    """Return the world of a configuration, which a worker process builds once for all its jobs."""
    return World(Plan.make(config))
