"""One way to run a node as a process."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.utilities import ok, try_shutdown

from sfr_loc_map.errors import NodeError, SfrError
from sfr_loc_map.nodes.lifecycle.managed_node import ManagedNode
from sfr_loc_map.nodes.process import environment
from sfr_loc_map.nodes.process.supervisor import SUPERVISOR_VARIABLE

_PR_SET_PDEATHSIG = 1
_M_MMAP_THRESHOLD, _M_ARENA_MAX = -3, -8
_LARGE_BYTES = 131_072


def run(factory: Callable[[], Node], arguments: Sequence[str] | None = None) -> int:
    """Run one node until it is told to end.

    SIGINT and SIGTERM end it with exit code 0, also when more of them come while it ends.

    Args:
        factory: Makes the node after ROS has started.
        arguments: Command line; that of the process by default.

    Returns:
        Exit code: 0, or 2 where the node cannot start or cannot go on (one line on standard error says why).
    """
    node: Node | None = None
    try:
        environment.prepare()
        end_with_supervisor()
        _start(list(sys.argv if arguments is None else arguments))
        executor = SingleThreadedExecutor()
        node = _make(factory)
        executor.add_node(node)
        if isinstance(node, ManagedNode):
            node.start()
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except SfrError as error:
        print(f"{_name(node)}: " + " ".join(str(error).split()), file=sys.stderr)
        return 2
    except Exception:
        if ok():
            raise
        # A signal has shut ROS down while a callback ran: what the callback touched next failed.
    finally:
        _ignore_signals()  # a second one must not break the tidying up
        if node is not None:
            node.destroy_node()
        try_shutdown()
        _ignore_signals()  # the shutdown puts the former handlers back
    return 0


def end_with_supervisor() -> None:
    """Ask the kernel to end this process when the one that started it has gone, however it went (Linux).

    Does nothing for a process that no supervisor of ours started.

    Raises:
        KeyboardInterrupt: If it has gone already.
    """
    supervisor = os.environ.pop(SUPERVISOR_VARIABLE, "")
    if not supervisor or not sys.platform.startswith("linux"):
        return
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != int(supervisor):
        raise KeyboardInterrupt


def configure_malloc() -> None:
    """Make glibc give large blocks back at once and keep all small ones together; does nothing elsewhere.

    For processes that run without end and are in no hurry: what one thread makes and another one frees, between blocks
    of all sizes, otherwise leaves ever more holes. It must come before other threads are started.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform.startswith("linux") else None
    if mallopt is not None:
        mallopt(_M_MMAP_THRESHOLD, _LARGE_BYTES)
        mallopt(_M_ARENA_MAX, 1)


def _start(arguments: list[str]) -> None:
    try:
        rclpy.init(args=arguments)
    except Exception as error:  # rclpy's classes for bad arguments and bad parameter files share no root
        raise NodeError(f"ROS does not start with these arguments and settings: {error}") from error


def _make(factory: Callable[[], Node]) -> Node:
    try:
        node = factory()
    except SfrError:
        raise
    except Exception as error:
        if ok():
            raise
        raise ExternalShutdownException from error
    if not ok():
        node.destroy_node()
        raise ExternalShutdownException
    return node


def _ignore_signals() -> None:
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)


def _name(node: Node | None) -> str:
    return str(node.get_name()) if node is not None else Path(sys.argv[0]).stem
