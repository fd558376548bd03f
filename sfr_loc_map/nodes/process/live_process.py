"""The live page beside a replay or the nodes: a process of its own, whose end matters to nobody."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from signal import SIGUSR1

from sfr_loc_map.errors import NodeError
from sfr_loc_map.nodes.process.node_process import NodeProcess
from sfr_loc_map.nodes.process.supervisor import end_processes

MODULE = "nodes.live.page"


class LivePage:
    """The page as the run beside it sees it."""

    def __init__(self, process: NodeProcess) -> None:
        """Take the process of the page, started or not."""
        self._process = process

    @property
    def node_name(self) -> str:
        """Name of its node, which joins the graph after the page is served; empty where the page does not run."""
        return node_name_of(self._process.popen.pid) if self._process.is_running else ""

    def run_is_over(self) -> None:
        """Tell it, without waiting, that the run is over, before the nodes end."""
        if self._process.is_running:
            self._process.send(SIGUSR1)


def node_name_of(pid: int) -> str:
    """Return the name of the node of the page that is the process `pid`."""
    return f"sfr_live_{pid}"


@contextmanager
def live_page(arguments: Sequence[str]) -> Iterator[LivePage]:
    """Run the page during the `with` block; it writes its address to standard output.

    The block goes on whatever becomes of the page; what it has to say of that stands on standard error.

    Args:
        arguments: Command line of the page.

    Yields:
        The page.
    """
    process = NodeProcess(MODULE, arguments)
    with suppress(NodeError):  # too little memory for the page: the run goes on
        process.start()
    try:
        yield LivePage(process)
    finally:
        end_processes([process])
