"""What a process needs before and when it starts ROS: environment variables, a domain, `rclpy.init`."""

from __future__ import annotations

import os
import sys
from collections.abc import MutableMapping, Sequence
from pathlib import Path
from typing import Any

from sfr_loc_map.errors import NodeError

PROFILE = Path(__file__).with_name("profiles") / "fastdds_shm.xml"
"""Fast DDS profile with a shared-memory segment that holds large images and clouds."""
PROFILE_VARIABLES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
"""Environment variables from which Fast DDS 2 (ROS 2 Jazzy) and Fast DDS 3 read their profile."""
EXPORT_LINE = f"export {' '.join(f'{name}={PROFILE}' for name in PROFILE_VARIABLES)}"
"""What a camera driver's shell needs."""
DOMAINS = 101  #: Domains 1 to 101 have ports below the ephemeral range.


def prepare(environment: MutableMapping[str, str] = os.environ) -> None:
    """Set missing variables; those that the user has set stay.

    An empty profile variable counts as not set: Fast DDS would report it as a broken file. The pip wheels of ROS do not
    set the path of their package index.
    """
    chosen = next(filter(None, map(environment.get, PROFILE_VARIABLES)), str(PROFILE))
    for name in PROFILE_VARIABLES:
        environment[name] = environment.get(name) or chosen
    environment.setdefault("AMENT_PREFIX_PATH", sys.prefix)


def see_whole_graph(environment: MutableMapping[str, str] = os.environ) -> None:
    """Be a super client where a discovery server is used: others are told of nothing but what they subscribe to."""
    if environment.get("ROS_DISCOVERY_SERVER") and not environment.get("ROS_SUPER_CLIENT"):
        environment["ROS_SUPER_CLIENT"] = "TRUE"


def isolate(environment: MutableMapping[str, str] = os.environ) -> None:
    """Choose a domain by the number of this process and stay on this host, unless the user chose."""
    if not environment.get("ROS_DOMAIN_ID"):
        environment["ROS_DOMAIN_ID"] = str(1 + os.getpid() % DOMAINS)
    if not environment.get("ROS_LOCALHOST_ONLY"):
        environment.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")


def start_ros(arguments: Sequence[str] = (), *, signals: bool = False) -> None:
    """Start ROS with a command line; signals stay with the program unless ROS is to shut down by them.

    Raises NodeError if it does not start: bad arguments or parameter files, a log folder that cannot be written.
    """
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    options: dict[str, Any] = {} if signals else {"signal_handler_options": SignalHandlerOptions.NO}
    prepare()
    try:
        rclpy.init(args=list(arguments), **options)
    except Exception as error:  # rclpy's classes for these share no root
        raise NodeError(f"ROS does not start with these arguments and settings: {error}") from error
