"""Starts ROS in this process, with what keeps it from starting as an error of ours."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import rclpy

from sfr_loc_map.errors import NodeError


def start_ros(arguments: Sequence[str], **options: Any) -> None:  # noqa: ANN401 - those of rclpy
    """Start ROS.

    Args:
        arguments: Command line.
        options: Of `rclpy.init`.

    Raises:
        NodeError: If it does not start: bad arguments or parameter files, a log folder that cannot be written.
    """
    try:
        rclpy.init(args=list(arguments), **options)
    except Exception as error:  # rclpy's classes for these share no root
        raise NodeError(f"ROS does not start with these arguments and settings: {error}") from error
