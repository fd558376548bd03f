"""Run the live page as a process beside `sfr run` or a replay."""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path

from msgspec.structs import replace

from sfr_loc_map.errors import NodeError, SfrError
from sfr_loc_map.live.run_end import RunEnd
from sfr_loc_map.message_text import one_line
from sfr_loc_map.ros.processes import WATCH_S, end_processes, node_process
from sfr_loc_map.signals import stopping


class PageProcess(AbstractContextManager["PageProcess"]):
    """The process of the live page, whose exit does not affect the run; a context manager.

    The page prints its address to standard output, and the reason for an error to standard error. The end of a run is
    reported in this order:

    | method | called by | when |
    |---|---|---|
    | `aborted` | `shown_on`, around the nodes of a run | an error of the suite ends the run |
    | `played` | `replay.session` | the source was played, before the nodes end |
    | `scored` | `cli.replay` | the complete run is scored, and its report is written |
    | `stay` | `cli.live_option` | after a replay, also after an error once `has_run_ended` |
    """

    def __init__(self, arguments: Sequence[str]) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="sfr-live-", ignore_cleanup_errors=True)
        self._end = RunEnd()
        self._end_file = Path(self._folder.name) / "end.json"
        self.has_run_ended = False  #: Whether a run that the page shows is over.
        self._process = node_process("live.main", (*arguments, "--end-file", str(self._end_file)))

    def __exit__(self, *_: object) -> None:
        end_processes([self._process])
        self._folder.cleanup()

    @property
    def is_running(self) -> bool:
        """Whether the process runs."""
        return self._process.is_running

    @property
    def node_name(self) -> str:
        """Name of the page's ROS node, which joins the graph once the process has started."""
        return page_node_name(self._process.popen.pid)

    def played(self) -> None:
        """Report that the source was played and the nodes will end; their silence is then not stale data."""
        self._write(self._end)

    def scored(self, score: str, report: Path | None) -> None:
        """Report the score of the complete run as JSON, and the path of its HTML report, None without one.

        The page shows this score in place of the score of the monitor.
        """
        self._write(replace(self._end, score=score, report="" if report is None else str(report)))

    def aborted(self, cause: str) -> None:
        """Report that the run was aborted."""
        self._write(replace(self._end, aborted=cause))

    def _write(self, end: RunEnd) -> None:
        """Write the end of the run for the page's process."""
        self.has_run_ended = True
        self._end = end
        end.write(self._end_file)

    def stay(self, words: str = "") -> None:
        """Print `words` and that the page is still served; wait until a signal arrives or the page ends."""
        if self.is_running:
            print(f"{words}the run has ended; its page is served until Ctrl-C", file=sys.stderr, flush=True)
            with suppress(KeyboardInterrupt), stopping() as ended:
                while self.is_running and not ended():
                    time.sleep(WATCH_S)


@contextmanager
def shown_on(page: PageProcess | None) -> Iterator[None]:
    """If an error of the suite aborts the run in the `with` block, report the abort to the page, if there is one."""
    try:
        yield
    except SfrError as error:
        if page is not None:
            problem = one_line(error.problem)
            # the error of a node that has ended also has its last log line
            page.aborted(problem.partition(": ")[0] if isinstance(error, NodeError) else problem)
        raise


def page_node_name(pid: int) -> str:
    """Return the name of the ROS node of the page with the process id `pid`."""
    return f"sfr_live_{pid}"


def connected_nodes_topic(node_name: str) -> str:
    """Return the topic on which a page, whose ROS node has this name, publishes its connected nodes (std_msgs/String).

    The message has the names of the connected nodes of the suite, separated by blanks. A node is connected once the
    page receives all messages of the node. The topic is hidden, as its name begins with `_`, and is not recorded by
    default.
    """
    return f"_{node_name}/connected_nodes"
