"""Python types of messages by the names that ROS gives them."""

from __future__ import annotations

import importlib
from typing import Any

from sfr_loc_map.errors import NodeError


def message_type(msgtype: str) -> type[Any]:
    """Return the type of a name such as `sensor_msgs/msg/Image`.

    Raises:
        NodeError: If its package is not installed.
    """
    package, _, name = msgtype.split("/")
    try:
        found: type[Any] = getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError) as error:
        raise NodeError(f"messages of type {msgtype} are not known here: install or source {package}") from error
    return found
