"""Runs a node as the main program of a process."""

from __future__ import annotations

import gc
import signal
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from types import FrameType

from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.utilities import ok, try_shutdown

from sfr_loc_map.errors import SfrError
from sfr_loc_map.inputs import one_line
from sfr_loc_map.nodes.lifecycle.managed_node import ManagedNode
from sfr_loc_map.nodes.process import environment
from sfr_loc_map.nodes.process.node_process import end_with_supervisor
from sfr_loc_map.nodes.process.ros_start import start_ros
from sfr_loc_map.nodes.process.start import SIGNALS


def run(factory: Callable[[], Node], arguments: Sequence[str] | None = None) -> int:
    """Run one node until SIGINT or SIGTERM.

    Both end it with exit code 0, also when more of them come while it ends.

    Args:
        factory: Makes the node after ROS has started.
        arguments: Command line; that of the process by default.

    Returns:
        Exit code: 0, or 2 where the node cannot start or cannot go on (one line on standard error says why).
    """
    node: Node | None = None
    handler = _SignalHandler()
    try:
        environment.prepare()
        end_with_supervisor()
        start_ros(sys.argv if arguments is None else arguments)
        handler.has_ros_started = True
        executor = SingleThreadedExecutor()
        node = _make(factory)
        executor.add_node(node)
        if isinstance(node, ManagedNode):
            node.start()
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except SfrError as error:
        print(f"{_name(node)}: {one_line(str(error))}", file=sys.stderr)
        return 2
    except Exception:
        if ok():
            raise
        # A signal has shut ROS down while a callback ran; the next ROS call of the callback failed.
    finally:
        _ignore_signals()  # a second one must not interrupt the shutdown
        if node is not None:
            node.destroy_node()
        else:
            gc.collect()  # a node that a signal left half made takes its shared memory with it
        try_shutdown()
        _ignore_signals()  # the shutdown puts the former handlers back
    return 0


class _SignalHandler:
    """Raises KeyboardInterrupt on SIGINT and SIGTERM until ROS has started; then the handlers of ROS shut it down.

    An exception would no longer be safe: numba loads compiled code in a callback from C, where an exception is
    discarded, and then calls a kernel that is not loaded (SIGSEGV).
    """

    def __init__(self) -> None:
        self.has_ros_started = False
        for number in SIGNALS:
            signal.signal(number, self)

    def __call__(self, number: int, frame: FrameType | None) -> None:
        if not self.has_ros_started:
            raise KeyboardInterrupt


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
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)


def _name(node: Node | None) -> str:
    return str(node.get_name()) if node is not None else Path(sys.argv[0]).stem
