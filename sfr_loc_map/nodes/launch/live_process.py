"""Run the live page beside a replay or the nodes, as a process."""

from __future__ import annotations

import json
import shutil
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import AbstractContextManager, suppress
from pathlib import Path

from sfr_loc_map.atomic import write_text
from sfr_loc_map.nodes.launch.processes import WATCH_S, end_processes, node_process
from sfr_loc_map.signals import stopping


class LiveProcess(AbstractContextManager["LiveProcess"]):
    """The process of the live page, whose exit does not affect the run; a context manager.

    The page prints its address to standard output, and the reason of an error to standard error.
    """

    def __init__(self, arguments: Sequence[str]) -> None:
        self._folder = Path(tempfile.mkdtemp(prefix="sfr-live-"))
        self._end_file, self._told = self._folder / "end.json", dict[str, str]()
        self._process = node_process("nodes.view.main", (*arguments, "--end-file", str(self._end_file)))

    def __exit__(self, *_: object) -> None:
        end_processes([self._process])
        shutil.rmtree(self._folder, ignore_errors=True)

    @property
    def node_name(self) -> str:
        """Name of the page's node, which joins the graph once the page is served; empty if the page does not run."""
        return page_node_name(self._process.popen.pid) if self._process.is_running else ""

    def run_is_over(self, **told: str) -> None:
        """Tell the page, through a file that it reads periodically, that the run is over; call before the nodes end.

        `missing`: what the estimate is known to lack; `aborted`: the cause of an abort; `report`: path of the report.
        """
        self._told |= told
        with suppress(OSError):
            write_text(json.dumps(self._told), self._end_file)

    def stay(self, words: str = "") -> None:
        """Print `words` and that the page is still served; wait until a signal arrives or the page ends."""
        if self._process.is_running:
            print(f"{words}the run is over; its page is served until Ctrl-C", file=sys.stderr, flush=True)
            with suppress(KeyboardInterrupt), stopping() as ended:
                while self._process.is_running and not ended():
                    time.sleep(WATCH_S)


def page_node_name(pid: int) -> str:
    """Return the name of the ROS node of the page with the process id `pid`."""
    return f"sfr_live_{pid}"
