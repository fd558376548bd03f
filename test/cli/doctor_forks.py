"""Runs `sfr doctor` several times at once: doctor_forks.py RUNS.json; the imports are done once, each run is a fork.

Each run has `environment` (variables), `arguments` (after `doctor`) and `log`; the exit codes are printed as JSON.
"""

import json
import os
import sys
from pathlib import Path

from sfr_loc_map.cli.main import main
from sfr_loc_map.nodes.tools import graph_observation  # noqa: F401 - imported before the forks
from sfr_loc_map.pipeline import doctor  # noqa: F401 - imported before the forks


def fork(run: dict[str, object]) -> int:
    """Start one run; return its process."""
    pid = os.fork()
    if pid:
        return pid
    os.environ.update(run["environment"])
    log = os.open(run["log"], os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
    for stream in (1, 2):
        os.dup2(log, stream)
    sys.argv = ["sfr", "doctor", *run["arguments"]]
    code = 70
    try:
        code = main()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


if __name__ == "__main__":
    children = {name: fork(run) for name, run in json.loads(Path(sys.argv[1]).read_text()).items()}
    codes = {name: os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) for name, pid in children.items()}
    print(json.dumps(codes), flush=True)
