"""The nodes as a group of processes that one process starts, and ends when it is told to or one of them ends."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.nodes.process import environment
from sfr_loc_map.nodes.process.supervisor import Supervisor, sigterm_as_interrupt

TASKS = ("localisation", "mapping", "monitor")
EVERYTHING = "all"
LOOK_S = 0.2
REST_S = 1.0
"""Pause after a node that broke down was started again."""


def nodes_of(words: Sequence[str]) -> list[str]:
    """Return the names of the nodes that words stand for, each once.

    Args:
        words: Of `TASKS`, or `all`; none stands for all.

    Raises:
        ConfigError: For another word.
    """
    for word in words:
        if word not in (*TASKS, EVERYTHING):
            raise ConfigError(f"'{word}' is no node: give {EVERYTHING}, {', '.join(TASKS)}; for ROS after --ros-args")
    everything = not words or EVERYTHING in words
    return [f"{task}_node" for task in TASKS if everything or task in words]


def run_group(nodes: Sequence[str], arguments: Sequence[str], say: Callable[[str], None], *, respawn: bool) -> None:
    """Run nodes, one process each, until SIGINT or SIGTERM; what they say goes to standard output and error.

    Args:
        nodes: Their names.
        arguments: Command line of each.
        say: Called with what happens to the group.
        respawn: Start a node again that breaks down, rather than end the others.

    Raises:
        NodeError: If a node ends; the others have been ended then.
    """
    environment.prepare()
    try:
        with sigterm_as_interrupt(), Supervisor() as supervisor:
            for node in nodes:
                supervisor.start(node, arguments)
            while True:
                time.sleep(LOOK_S)
                if not respawn:
                    supervisor.check()
                    continue
                for end in supervisor.revive():
                    say(f"{end}: started again")
                    time.sleep(REST_S)
    except KeyboardInterrupt:
        return
