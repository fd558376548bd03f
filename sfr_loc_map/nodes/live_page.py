"""The page of a running graph as the program of a process."""

from __future__ import annotations

import argparse
import asyncio
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from sfr_loc_map.config import build
from sfr_loc_map.errors import SfrError
from sfr_loc_map.inputs import one_line
from sfr_loc_map.live.server import DEFAULT_HOST, DEFAULT_PORT, LiveConfig, LiveServer, serve_until_signal
from sfr_loc_map.live.state import LiveState
from sfr_loc_map.nodes.environment import configure_malloc
from sfr_loc_map.signals import handle_signals

NICENESS = 5  #: What only looks on gives way to what it looks at: a third of the weight of other processes.


def serve_graph(config: LiveConfig, namespace: str, end_file: Path | None = None) -> None:
    """Serve the page of a running graph until a signal, at a lower priority than its nodes."""
    from sfr_loc_map.nodes.live_feed import RosFeed

    os.nice(NICENESS)
    state = LiveState()
    with RosFeed(state, namespace):
        asyncio.run(serve_until_signal(LiveServer(config, state, namespace), end_file=end_file))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the page beside a replay or the nodes; return the exit code."""
    handle_signals()
    parser = argparse.ArgumentParser()
    parser.add_argument("--namespace", default="")
    parser.add_argument("--host", default=DEFAULT_HOST)
    parser.add_argument("--port", type=int, default=DEFAULT_PORT)
    parser.add_argument("--token", default="")
    parser.add_argument("--end-file", type=Path)
    options = parser.parse_args(arguments)
    configure_malloc()  # before there is another thread
    try:
        values = {"host": options.host, "port": options.port, "token": options.token}
        serve_graph(build(LiveConfig, values, origin="sfr live"), options.namespace, options.end_file)
    except KeyboardInterrupt:
        return 0
    except SfrError as error:
        print(f"sfr live: {one_line(str(error))}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
