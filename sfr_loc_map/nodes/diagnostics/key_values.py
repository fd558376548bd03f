"""Figures of the nodes on /diagnostics, as text that reads back to the same number."""

from __future__ import annotations

import socket
from collections.abc import Mapping
from enum import IntEnum

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from std_msgs.msg import Header

Value = str | bool | int | float
HARDWARE_ID = socket.gethostname()
"""Of each status: the host that the node runs on, whose time and memory it tells."""
TOPIC = "/diagnostics"
CALL = "call"
"""Name, after the node's, of the status that describes one call."""


class Level(IntEnum):
    """Levels of diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


def status_msg(name: str, level: Level, message: str, values: Mapping[str, Value]) -> DiagnosticStatus:
    """Return one status; numbers are written in the shortest form that reads back to the same bits."""
    pairs = [KeyValue(key=key, value=_text(value)) for key, value in values.items()]
    return DiagnosticStatus(level=bytes([level]), name=name, message=message, hardware_id=HARDWARE_ID, values=pairs)


def array_msg(header: Header, *statuses: DiagnosticStatus) -> DiagnosticArray:
    """Return statuses as the message of the topic."""
    return DiagnosticArray(header=header, status=list(statuses))


def call_name(node_name: str) -> str:
    """Return the name of the status that describes one call.

    Args:
        node_name: Fully qualified name of the node.
    """
    return f"{node_name.lstrip('/')}: {CALL}"


def values_of(status: DiagnosticStatus) -> dict[str, str]:
    """Return the values of a status by name."""
    return {pair.key: pair.value for pair in status.values}


def level_of(status: DiagnosticStatus) -> Level:
    """Return the level of a status; the message class gives it as one byte."""
    level = status.level
    return Level(level[0] if isinstance(level, bytes) else int(level))


def _text(value: Value) -> str:
    return value if isinstance(value, str) else repr(_python(value))


def _python(value: bool | int | float) -> bool | int | float:
    """Return numbers of numpy as Python's, whose text has no type in it."""
    item = getattr(value, "item", None)
    return item() if item is not None else value
