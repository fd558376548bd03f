"""The process of one task: `python -m sfr_loc_map.suite.task_process TASK RESULT CACHE SLOT`.

Exit code 0: the result is written. 2: bad input, the last line of the log says what. Anything else: a fault.
"""

from __future__ import annotations

import ctypes
import json
import os
import signal
import sys
from pathlib import Path

from sfr_loc_map.child_process import end_with_parent
from sfr_loc_map.errors import SfrError
from sfr_loc_map.metrics.score_json import from_plain
from sfr_loc_map.suite.task import Task

BAD_INPUT = 2
_PR_SET_CHILD_SUBREAPER = 36


def main(arguments: list[str]) -> int:
    """Run a task.

    Args:
        arguments: File of the task, file of the result, folder of simulated sources, number of the slot that it runs
            in (-1 for none).

    Returns:
        The exit code.
    """
    end_with_parent(signal.SIGKILL)
    task_file, result, cache = map(Path, arguments[:3])
    task = from_plain(Task, json.loads(task_file.read_text(encoding="utf-8")))
    _confine(task.threads, int(arguments[3]))
    from sfr_loc_map.io.atomic import atomic_path
    from sfr_loc_map.metrics.score_json import to_json
    from sfr_loc_map.suite.task_run import run_task

    try:
        score = run_task(task, Path.cwd(), cache)
    except SfrError as error:
        print(" ".join(str(error).split()), file=sys.stderr)
        return BAD_INPUT
    with atomic_path(result) as temporary:
        temporary.write_text(to_json(score), encoding="utf-8")
    return 0


def adopt_orphans() -> None:
    """Ask the kernel to make this process the parent of descendants that lose theirs (Linux)."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1)


def _confine(threads: int, slot: int) -> None:
    """Keep to the cores of a slot, so that tasks side by side do not share any."""
    import cv2

    cv2.setNumThreads(threads)
    if slot < 0 or not hasattr(os, "sched_setaffinity"):
        return
    cores = sorted(os.sched_getaffinity(0))
    if len(cores) >= threads:
        first = slot * threads % len(cores)
        os.sched_setaffinity(0, {cores[(first + offset) % len(cores)] for offset in range(threads)})


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
