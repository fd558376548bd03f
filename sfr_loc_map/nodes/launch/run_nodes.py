"""Run chosen nodes, each in its own process, until a signal arrives: the work of `sfr run`."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.ros import environment
from sfr_loc_map.ros.processes import WATCH_S, Supervisor
from sfr_loc_map.suite_names import SUITE_NODES

NODES = tuple(node.removesuffix("_node") for node in SUITE_NODES)  #: Names by which a user starts nodes.
EVERYTHING = "all"
RESTART_PAUSE_S = 1.0  #: Pause after a restart, so that a node that crashes repeatedly does not load the host.


def node_names(chosen: Sequence[str]) -> list[str]:
    """Return the full names of chosen nodes (of `NODES`, or `all`) without duplicates; all if none is chosen."""
    for name in chosen:
        if name not in (*NODES, EVERYTHING):
            raise ConfigError(
                f"'{name}' is not a node: give {EVERYTHING}, {', '.join(NODES)}; arguments for ROS follow --ros-args"
            )
    everything = not chosen or EVERYTHING in chosen
    return [f"{name}_node" for name in NODES if everything or name in chosen]


def run_nodes(nodes: Sequence[str], arguments: Sequence[str], say: Callable[[str], None], *, respawn: bool) -> None:
    """Run nodes with the same arguments, each in its own process, until a signal arrives.

    With `respawn`, crashed nodes are restarted and reported by `say`. If a node ends without a crash, or crashes
    without `respawn`, all nodes are ended and a NodeError is raised.
    """
    environment.prepare()
    try:
        with Supervisor() as supervisor:
            for node in nodes:
                supervisor.start(node, arguments)
            while True:
                time.sleep(WATCH_S)
                if not respawn:
                    supervisor.check()
                    continue
                for ending in supervisor.restart_crashed():
                    say(f"{ending}: restarted")
                    time.sleep(RESTART_PAUSE_S)
    except KeyboardInterrupt:
        return
