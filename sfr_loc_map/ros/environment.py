"""Start ROS in a process: environment variables, domain, `rclpy.init`."""

from __future__ import annotations

import os
import re
import shlex
import sys
from collections.abc import Mapping, MutableMapping, Sequence
from pathlib import Path
from typing import Any

from sfr_loc_map.errors import NodeError
from sfr_loc_map.ros.domains import HeldDomain, hold_domain

PROFILE = Path(__file__).with_name("profiles") / "fastdds_shm.xml"
"""Fast DDS profile with a shared-memory segment large enough for images and clouds."""
PROFILE_VARIABLES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
"""Environment variables from which Fast DDS 2 (ROS 2 Jazzy) and Fast DDS 3 read their profile."""
TRANSPORTS_VARIABLE = "FASTDDS_BUILTIN_TRANSPORTS"  #: Environment variable that selects transports without a profile.
EXPORT_LINE = f"export {' '.join(f'{name}={shlex.quote(str(PROFILE))}' for name in PROFILE_VARIABLES)}"
"""Command that selects the profile in the shell of a camera driver."""
PLACE_IN_ROS = re.compile(r",? at \S+\.c(?:pp)?:\d+")  #: Place in the source code of ROS in its messages.
MIDDLEWARE = "rmw_typesupport"  #: Kind of resource by which each installed middleware is registered.
_held: list[HeldDomain] = []  # domains that this process has chosen, which it holds until its end


def prepare(environment: MutableMapping[str, str] = os.environ) -> None:
    """Set missing environment variables; variables set by the user are kept.

    An empty profile variable counts as missing, because Fast DDS would report an invalid file. If the user has chosen
    transports (`TRANSPORTS_VARIABLE`), no profile is set, because a profile would replace them. AMENT_PREFIX_PATH is
    set because the pip wheels of ROS do not set the path of their package index.
    """
    default = "" if environment.get(TRANSPORTS_VARIABLE) else str(PROFILE)
    chosen = next(filter(None, map(environment.get, PROFILE_VARIABLES)), default)
    for name in PROFILE_VARIABLES:
        profile = environment.pop(name, "") or chosen
        if profile:
            environment[name] = profile
    environment.setdefault("AMENT_PREFIX_PATH", sys.prefix)


def check_middleware(environment: Mapping[str, str] = os.environ) -> None:
    """Raise a NodeError if RMW_IMPLEMENTATION names a middleware that is not installed.

    The import of rclpy would end the process with exit code 102.
    """
    from ament_index_python import get_resources

    wanted, installed = environment.get("RMW_IMPLEMENTATION"), [*get_resources(MIDDLEWARE)]
    if wanted and installed and wanted not in installed:
        names = ", ".join(name for name in installed if name != "rmw_implementation")
        raise NodeError(
            f"RMW_IMPLEMENTATION is {wanted}, which is not installed (installed: {names}): install it, or unset the "
            "variable"
        )


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
        text = PLACE_IN_ROS.sub("", str(error))
        raise NodeError(f"ROS cannot be initialised with these arguments and settings: {text}") from error
