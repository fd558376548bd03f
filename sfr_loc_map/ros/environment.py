"""Start ROS in a process: environment variables, domain, `rclpy.init`."""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import MutableMapping, Sequence
from pathlib import Path
from typing import Any

from sfr_loc_map.errors import NodeError
from sfr_loc_map.ros.domains import HeldDomain, hold_domain

PROFILE = Path(__file__).with_name("profiles") / "fastdds_shm.xml"
"""Fast DDS profile with a shared-memory segment large enough for images and clouds."""
PROFILE_VARIABLES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
"""Environment variables from which Fast DDS 2 (ROS 2 Jazzy) and Fast DDS 3 read their profile."""
EXPORT_LINE = f"export {' '.join(f'{name}={shlex.quote(str(PROFILE))}' for name in PROFILE_VARIABLES)}"
"""Command that selects the profile in the shell of a camera driver."""
_held: list[HeldDomain] = []  # domains that this process has chosen, which it holds until its end


def prepare(environment: MutableMapping[str, str] = os.environ) -> None:
    """Set missing environment variables; variables set by the user are kept.

    An empty profile variable counts as missing, because Fast DDS would report an invalid file. AMENT_PREFIX_PATH is
    set because the pip wheels of ROS do not set the path of their package index.
    """
    chosen = next(filter(None, map(environment.get, PROFILE_VARIABLES)), str(PROFILE))
    for name in PROFILE_VARIABLES:
        environment[name] = environment.get(name) or chosen
    environment.setdefault("AMENT_PREFIX_PATH", sys.prefix)


def domain() -> str:
    """Return the ROS domain of this process and its discovery server, if it has one, for messages."""
    number = os.environ.get("ROS_DOMAIN_ID") or "0"
    server = os.environ.get("ROS_DISCOVERY_SERVER")
    return f"{number} (discovery server {server})" if server else number


def see_whole_graph(environment: MutableMapping[str, str] = os.environ) -> None:
    """Become a super client of a discovery server; normal clients see only endpoints of their own topics."""
    if environment.get("ROS_DISCOVERY_SERVER") and not environment.get("ROS_SUPER_CLIENT"):
        environment["ROS_SUPER_CLIENT"] = "TRUE"


def isolate(environment: MutableMapping[str, str] = os.environ) -> None:
    """Choose a domain for this process and restrict discovery to this host; variables set by the user are kept."""
    if not environment.get("ROS_DOMAIN_ID"):
        _held.append(hold_domain())
        environment["ROS_DOMAIN_ID"] = str(_held[-1].number)
    if not environment.get("ROS_LOCALHOST_ONLY"):
        environment.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")


def start_ros(arguments: Sequence[str] = (), *, signals: bool = False) -> None:
    """Start ROS with a command line. With `signals`, ROS installs its handlers and shuts down on signals.

    Raises a NodeError for invalid arguments or parameter files, or a log folder that is not writable.
    """
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    options: dict[str, Any] = {} if signals else {"signal_handler_options": SignalHandlerOptions.NO}
    prepare()
    try:
        rclpy.init(args=list(arguments), **options)
    except Exception as error:  # rclpy's exceptions have no common base class
        raise NodeError(f"ROS cannot be initialised with these arguments and settings: {error}") from error
