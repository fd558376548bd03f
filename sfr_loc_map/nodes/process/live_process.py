"""The live page beside a replay or the nodes: a process of its own, whose end matters to nobody."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from signal import SIGUSR1

from sfr_loc_map.errors import NodeError
from sfr_loc_map.nodes.process.node_process import NodeProcess
from sfr_loc_map.nodes.process.supervisor import end_processes

MODULE = "nodes.live.page"


@contextmanager
def live_page(arguments: Sequence[str]) -> Iterator[Callable[[], None]]:
    """Run the page during the `with` block; it writes its address to standard output.

    The block goes on whatever becomes of the page; what it has to say of that stands on standard error.

    Args:
        arguments: Command line of the page.

    Yields:
        What tells the page, without waiting, that the run is over, before the nodes end.
    """
    process = NodeProcess(MODULE, arguments)
    with suppress(NodeError):  # too little memory for the page: the run goes on
        process.start()

    def run_is_over() -> None:
        if process.is_running:
            process.send(SIGUSR1)

    try:
        yield run_is_over
    finally:
        end_processes([process])
