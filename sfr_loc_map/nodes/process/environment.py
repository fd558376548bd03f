"""Environment variables of a process that must be set before ROS starts."""

from __future__ import annotations

import os
import random
import socket
import sys
from collections.abc import MutableMapping
from pathlib import Path

from sfr_loc_map.errors import NodeError

PROFILE = Path(__file__).with_name("profiles") / "fastdds_shm.xml"
"""Fast DDS profile with a shared-memory segment that holds large images and clouds."""
OLD_PROFILE_VARIABLE = "FASTRTPS_DEFAULT_PROFILES_FILE"
DOMAINS = 101
"""Domains 1 to 101 have ports below the ephemeral range."""


def profile_variable(environment: MutableMapping[str, str] = os.environ) -> str:
    """Return the name of the variable that tells the Fast DDS of this ROS which profile to load.

    Fast DDS 2 (Jazzy) reads the old name only; Fast DDS 3 (Kilted), whose package is named fastdds, reads a new one and
    warns wherever the old one is set.
    """
    prefixes = [*environment.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix]
    is_new = any(prefix and Path(prefix, "share", "fastdds").is_dir() for prefix in prefixes)
    return "FASTDDS_DEFAULT_PROFILES_FILE" if is_new else OLD_PROFILE_VARIABLE


PROFILE_VARIABLE = profile_variable()
EXPORT_LINE = f"export {PROFILE_VARIABLE}={PROFILE}"
"""What a camera driver's shell needs."""


def prepare(environment: MutableMapping[str, str] = os.environ) -> None:
    """Set missing variables; those that the user has set stay.

    An empty profile variable counts as not set: Fast DDS would report it as a broken file. The pip wheels of ROS do not
    set the path of their package index.
    """
    if not environment.get(PROFILE_VARIABLE):
        environment[PROFILE_VARIABLE] = environment.get(OLD_PROFILE_VARIABLE) or str(PROFILE)
    environment.setdefault("AMENT_PREFIX_PATH", sys.prefix)


def isolate(environment: MutableMapping[str, str] = os.environ) -> None:
    """Choose a domain that no running program uses and stay on this host, unless the user chose.

    Raises:
        NodeError: If no domain is free.
    """
    if not environment.get("ROS_DOMAIN_ID"):
        environment["ROS_DOMAIN_ID"] = str(free_domain())
    if not environment.get("ROS_LOCALHOST_ONLY"):
        environment.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")


def free_domain() -> int:
    """Return a domain whose first participant's port is not in use on this host.

    The port is that of RTPS (OMG DDSI-RTPS 2.5, 9.6.2.3): 7400 + 250 domain + 10.

    Raises:
        NodeError: If all are in use.
    """
    for domain in random.sample(range(1, DOMAINS + 1), DOMAINS):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("", 7400 + 250 * domain + 10))
            except OSError:
                continue
            return domain
    raise NodeError(
        f"all ROS domains 1 to {DOMAINS} are in use on this host: end other ROS programs or set ROS_DOMAIN_ID"
    )
