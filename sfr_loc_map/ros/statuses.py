"""Statuses of /diagnostics: from values, and to values."""

from __future__ import annotations

import socket
from collections.abc import Mapping

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from sfr_loc_map.message_types import Level

Value = str | bool | int | float
HARDWARE_ID = socket.gethostname()  #: Host of the node, whose processing time and memory are reported.


def status_msg(name: str, level: Level, message: str, values: Mapping[str, Value]) -> DiagnosticStatus:
    """Return a status; numbers are written in the shortest form that is read back bit-identical."""
    plain = {key: value.item() if isinstance(value, np.generic) else value for key, value in values.items()}
    pairs = [KeyValue(key=key, value=value if isinstance(value, str) else repr(value)) for key, value in plain.items()]
    return DiagnosticStatus(level=bytes([level]), name=name, message=message, hardware_id=HARDWARE_ID, values=pairs)


def level_of(status: DiagnosticStatus) -> Level:
    """Return the level of a status, given as a byte or an integer; values above the range give the highest level."""
    level = status.level
    return Level(min(level[0] if isinstance(level, bytes) else int(level), max(Level)))


def values_of(status: DiagnosticStatus) -> dict[str, str]:
    """Return the values of a status by name."""
    return {pair.key: pair.value for pair in status.values}
