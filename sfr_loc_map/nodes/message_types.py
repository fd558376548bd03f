"""Python types of messages by the names that ROS gives them."""

from __future__ import annotations

import importlib
from typing import Any

from sfr_loc_map.errors import NodeError
from sfr_loc_map.io.bag import TYPESTORE


def message_type(msgtype: str) -> type[Any]:
    """Return the type of a name such as `sensor_msgs/msg/Image`; raises NodeError if its package is not installed."""
    package, _, name = msgtype.split("/")
    try:
        found: type[Any] = getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError) as error:
        raise NodeError(f"messages of type {msgtype} are not known here: install or source {package}") from error
    return found


def definition_of(msgtype: str) -> tuple[str, str]:
    """Return the text of a type with those within it, as bags have it, and its hash (RIHS01).

    Of a type that the bag library does not know both are empty words; readers then need its package.
    """
    if msgtype not in TYPESTORE.fielddefs:
        return "", "RIHS01_unknown"
    return TYPESTORE.generate_msgdef(msgtype, ros_version=2)[0], TYPESTORE.hash_rihs01(msgtype)
