"""A process that has imported what tasks need and forks one for each (`python -m` this module).

Imports take seconds, a fork takes milliseconds; each task is still a fresh process. Nothing here starts a thread: a
fork would not take it along. One line of JSON on standard input asks for a task: `arguments` of `task_process.main`,
the `work` folder, the `log` file, and a Python file to run in its place (`instead`, empty for none). Two lines answer:
its `pid`, then its exit `code`, once the task and all that it started are gone and their memory is free.
"""

from __future__ import annotations

import contextlib
import json
import os
import runpy
import signal
import sys
import time
import traceback
from typing import Any

from sfr_loc_map.child_process import end_with_parent
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.metrics.association import Estimates
from sfr_loc_map.metrics.config import TrajectoryScoreConfig
from sfr_loc_map.metrics.trajectory_score import score_trajectory
from sfr_loc_map.suite import task_process, task_run
from sfr_loc_map.suite.process_tree import descendants

FAULT = 70
assert task_run  # its import is what makes a fork quick
WARM_UP_POSES = 20
GONE_S = 10.0
"""Longest wait for what a task has left: the kernel may need a while to free the memory of a killed process."""


def main() -> int:
    """Fork a process for each line until the input ends."""
    end_with_parent(signal.SIGKILL)
    task_process.adopt_orphans()
    _load_kernels()
    for line in sys.stdin:
        order = json.loads(line)
        pid = os.fork()
        if pid == 0:
            os._exit(_child(order))
        print(json.dumps({"pid": pid}), flush=True)
        _, status = os.waitpid(pid, 0)
        _end_descendants()
        print(json.dumps({"code": os.waitstatus_to_exitcode(status)}), flush=True)
    return 0


def _end_descendants() -> None:
    """End what the task has left running, also in other sessions, and wait until all of it is gone."""
    deadline = time.monotonic() + GONE_S
    while time.monotonic() < deadline:
        try:
            if os.waitpid(-1, os.WNOHANG)[0] == 0:
                for pid in descendants(os.getpid()):
                    with contextlib.suppress(ProcessLookupError, PermissionError):
                        os.kill(pid, signal.SIGKILL)
                time.sleep(0.005)
        except ChildProcessError:
            return


def _load_kernels() -> None:
    """Score a drive, so that the kernels of the score are loaded; those of the localiser would start threads."""
    poses = [(number, Transform.from_quat([number, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0])) for number in range(WARM_UP_POSES)]
    drive = Trajectory.from_poses(poses)
    score_trajectory(Estimates.of(drive), drive, TrajectoryScoreConfig(conditions=("frames=2",), spacing=1))


def _child(order: dict[str, Any]) -> int:
    """Run a task in a session of its own; return its exit code."""
    os.setsid()
    os.chdir(order["work"])
    log = os.open(order["log"], os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
    null = os.open(os.devnull, os.O_RDONLY)
    for source, target in ((null, 0), (log, 1), (log, 2)):
        os.dup2(source, target)
    code: int | str | None = FAULT
    try:
        if order["instead"]:
            sys.argv = [order["instead"], *order["arguments"]]
            runpy.run_path(order["instead"], run_name="__main__")
            code = 0
        else:
            code = task_process.main(order["arguments"])
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 0 if end.code is None else 1
    except BaseException:
        traceback.print_exc()
    sys.stdout.flush()
    sys.stderr.flush()
    return code if isinstance(code, int) else FAULT


if __name__ == "__main__":
    raise SystemExit(main())
