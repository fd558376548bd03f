"""Run a node as the main program of a process."""

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
from sfr_loc_map.message_text import one_line
from sfr_loc_map.nodes.lifecycle.managed_node import ManagedNode
from sfr_loc_map.ros import environment
from sfr_loc_map.signals import END_SIGNALS


def run(factory: Callable[[], Node], arguments: Sequence[str] | None = None) -> int:
    """Run a node until a signal and return 0. If an SfrError prevents the start, print it in one line and return 2."""
    node: Node | None = None
    has_ros_started = has_node_started = False

    def interrupt(number: int, frame: FrameType | None) -> None:
        # Once ROS has started, its own handlers shut it down. An exception would no longer be safe: numba loads
        # compiled code in a callback from C, which discards the exception. Calling the kernel, which is then not
        # loaded, ends with SIGSEGV.
        if not has_ros_started:
            raise KeyboardInterrupt
        if number == signal.SIGHUP:  # ROS does not handle SIGHUP
            signal.raise_signal(signal.SIGTERM)

    _set_handlers(interrupt)
    try:
        environment.start_ros(sys.argv if arguments is None else arguments, signals=True)
        has_ros_started = True
        executor = SingleThreadedExecutor()
        node = factory()
        executor.add_node(node)
        if isinstance(node, ManagedNode) and ok():
            node.start()
        has_node_started = True
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except SfrError as error:
        if has_node_started:  # exit code 2 would mean that a restart is useless
            raise
        name = node.get_name() if node is not None else Path(sys.argv[0]).stem
        print(f"{name}: {one_line(str(error))}", file=sys.stderr)
        return 2
    except Exception:
        if not has_ros_started or ok():
            raise
        # A signal has shut ROS down while a callback ran, so its next use of ROS failed.
    finally:
        _set_handlers(signal.SIG_IGN)  # a second signal must not interrupt the shutdown
        if node is not None:
            node.destroy_node()
        else:
            gc.collect()  # frees the shared memory of a node whose construction was interrupted
        try_shutdown()
        _set_handlers(signal.SIG_IGN)  # the shutdown restores the previous handlers
    return 0


def _set_handlers(handler: Callable[[int, FrameType | None], None] | signal.Handlers) -> None:
    for number in END_SIGNALS:
        signal.signal(number, handler)
