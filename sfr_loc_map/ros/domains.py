"""ROS domains of this host. A program holds the domain that it has chosen, so that no other program chooses it.

To hold a domain, a program binds a UDP port of the domain that no participant uses. The operating system gives a port
to one program at a time, and releases the port when the program ends or crashes. Ports are those of RTPS (OMG DDSI-RTPS
2.5, 9.6.2.3): the first port of a domain is 7400 + 250 domain, and participant i uses the port 10 + 2 i above it.
"""

from __future__ import annotations

import random
import re
import socket
from collections.abc import Iterable
from pathlib import Path

from sfr_loc_map.errors import NodeError

DOMAINS = range(1, 102)
"""Domains from which one is chosen. Domain 0 is the default of ROS, and ports of domains above 101 are in the ephemeral
range.
"""
HELD_PORT = 249
"""Port that holds a domain, relative to the first port of the domain. Only the 120th participant would use it."""
PROBED_PARTICIPANTS = 10
"""Number of participants whose ports are probed. The first participants may have ended while later participants run."""
FIRST_PORT = 7400
"""First port of domain 0."""
PORTS_PER_DOMAIN = 250
SHARED_MEMORY = Path("/dev/shm")
"""Folder with the shared-memory ports of Fast DDS, named by their numbers."""


class HeldDomain:
    """A ROS domain that this process holds until `release` or its end; a context manager."""

    def __init__(self, number: int, lock: socket.socket) -> None:
        """Take the bound socket that holds the domain."""
        self.number = number
        self._lock = lock

    def __enter__(self) -> HeldDomain:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    def release(self) -> None:
        """Let other programs choose the domain."""
        self._lock.close()


def hold_domain(candidates: Iterable[int] = DOMAINS) -> HeldDomain:
    """Return a domain that no program holds and in which no participant of this host is found.

    Participants of programs that hold no domain are found by their ports, because a user may have chosen their domain.
    Domains with shared-memory ports are tried last: a killed process leaves its ports, and a container that shares only
    the memory of this host has participants whose UDP ports are not seen. Raises NodeError if there is no such domain.
    """
    shuffled = list(candidates)
    random.SystemRandom().shuffle(shuffled)  # so that the domain of a killed process is rarely chosen next
    used = _domains_in_shared_memory()
    shuffled.sort(key=lambda number: number in used)
    for number in shuffled:
        first_port = FIRST_PORT + PORTS_PER_DOMAIN * number
        lock = _bound(first_port + HELD_PORT)
        if lock is None:
            continue
        if not _has_participants(first_port):
            return HeldDomain(number, lock)
        lock.close()
    raise NodeError(
        f"all ROS domains from {min(shuffled)} to {max(shuffled)} are in use on this host: end a program that uses "
        "one, or set ROS_DOMAIN_ID"
    )


def _domains_in_shared_memory() -> set[int]:
    """Return the domains that have a shared-memory port of Fast DDS on this host."""
    names = (path.name for path in SHARED_MEMORY.glob("fastrtps_port*"))
    ports = (int(found[1]) for name in names if (found := re.fullmatch(r"fastrtps_port(\d+)", name)))
    return {(port - FIRST_PORT) // PORTS_PER_DOMAIN for port in ports}


def _has_participants(first_port: int) -> bool:
    """Return whether a participant uses one of the first ports of a domain."""
    for index in range(PROBED_PARTICIPANTS):
        probe = _bound(first_port + 10 + 2 * index)
        if probe is None:
            return True
        probe.close()
    return False


def _bound(port: int) -> socket.socket | None:
    """Return a socket that is bound to a UDP port of this host; None if the port is in use."""
    found = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        found.bind(("", port))
    except OSError:
        found.close()
        return None
    return found
