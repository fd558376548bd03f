"""The page of a running graph as the program of a process.

The page is there first: the imports of ROS and the entry into the graph go on while it is served.
"""

from __future__ import annotations

import argparse
import asyncio
import gc
import os
import sys
from collections.abc import Sequence
from contextlib import ExitStack

from sfr_loc_map.config import build
from sfr_loc_map.errors import SfrError
from sfr_loc_map.inputs import one_line
from sfr_loc_map.live.server import DEFAULT_HOST, DEFAULT_PORT, LiveConfig, LiveServer, serve_until_signal
from sfr_loc_map.live.state import LiveState
from sfr_loc_map.nodes.environment import configure_malloc

NICENESS = 5  #: What only looks on gives way to what it looks at: a third of the weight of other processes.


def serve_graph(config: LiveConfig, namespace: str, *, open_browser: bool = False) -> None:
    """Serve the page of a running graph until SIGINT or SIGTERM, at a lower priority than its nodes."""
    os.nice(NICENESS)
    asyncio.run(_serve(config, namespace, open_browser=open_browser))


async def _serve(config: LiveConfig, namespace: str, *, open_browser: bool) -> None:
    """Serve at once and join the graph meanwhile; end with the server, or if the graph cannot be joined."""
    state = LiveState()
    with ExitStack() as stack:
        server = LiveServer(config, state, namespace or "live")
        serving = asyncio.create_task(serve_until_signal(server, open_browser=open_browser))
        joining = asyncio.create_task(asyncio.to_thread(_join, stack, state, namespace))
        await asyncio.wait({serving, joining}, return_when=asyncio.FIRST_COMPLETED)
        try:
            if joining.done():
                joining.result()
            await serving
        finally:
            serving.cancel()
            await asyncio.wait({serving, joining})


def _join(stack: ExitStack, state: LiveState, namespace: str) -> None:
    from sfr_loc_map.nodes.live_feed import RosFeed

    stack.enter_context(RosFeed(state, namespace))
    gc.collect()
    gc.freeze()  # what is imported stays: cycles of pages that have gone are then found soon


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the page beside a replay or the nodes; return the exit code."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--namespace", default="")
    parser.add_argument("--host", default=DEFAULT_HOST)
    parser.add_argument("--port", type=int, default=DEFAULT_PORT)
    parser.add_argument("--token", default="")
    options = parser.parse_args(arguments)
    configure_malloc()  # before there is another thread
    try:
        values = {"host": options.host, "port": options.port, "token": options.token}
        serve_graph(build(LiveConfig, values, origin="sfr live"), options.namespace)
    except KeyboardInterrupt:
        return 0
    except SfrError as error:
        print(f"sfr live: {one_line(str(error))}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
