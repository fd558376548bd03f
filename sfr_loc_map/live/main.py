"""Run the live page of a running graph as the main program of a process."""

from __future__ import annotations

import argparse
import asyncio
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from sfr_loc_map.configuration.parameters import build
from sfr_loc_map.errors import SfrError
from sfr_loc_map.live.config import LiveConfig
from sfr_loc_map.live.server import LiveServer, serve_until_signal
from sfr_loc_map.live.state import LiveState
from sfr_loc_map.message_text import one_line
from sfr_loc_map.signals import handle_signals

NICENESS = 5
"""Niceness of the page. Under full load, the page gets a third of the processor time of a node (sched(7))."""


def serve_page(
    config: LiveConfig,
    state: LiveState,
    namespace: str,
    remaps: Sequence[str],
    *,
    open_browser: bool = False,
    end_file: Path | None = None,
) -> None:
    """Serve the page of the nodes in a namespace until a signal; `remaps` are the nodes' rules `FROM:=TO`."""
    from sfr_loc_map.live.feed import RosFeed

    with RosFeed(state, namespace, remaps) as feed:
        server = LiveServer(config, state, feed.operator, namespace)
        asyncio.run(serve_until_signal(server, open_browser=open_browser, end_file=end_file))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the page beside a replay or the nodes until a signal, at a lower priority; return the exit code."""
    handle_signals()
    parser = argparse.ArgumentParser(prog="sfr live")
    parser.add_argument("--namespace", default="")
    parser.add_argument("--port", type=int, required=True)
    parser.add_argument("-r", dest="remaps", action="append", default=[])
    parser.add_argument("--end-file", type=Path)
    options = parser.parse_args(arguments)
    os.nice(NICENESS)
    try:
        config = build(LiveConfig, {"port": options.port}, origin="", called={"port": "--port"})
        serve_page(config, LiveState(), options.namespace, options.remaps, end_file=options.end_file)
    except KeyboardInterrupt:
        return 0
    except SfrError as error:
        print(f"sfr live: {one_line(str(error))}", file=sys.stderr)
        return 2
    return 0
