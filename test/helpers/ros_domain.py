"""A ROS domain that no other program of this host uses, for a test.

Ports are those of RTPS (OMG DDSI-RTPS 2.5, 9.6.2.3): 7400 + 250 domain, and from there 10 + 2 i for participant i.
"""

from __future__ import annotations

import random
import socket
from collections import deque

from sfr_loc_map.ros.environment import DOMAINS

PROBED_PARTICIPANTS = 10  #: The first of a domain may have ended while others run.
HELD_PORT = 249  #: From the first port of a domain: no program reaches participant 119.
_held: deque[socket.socket] = deque(maxlen=16)


def free_domain() -> int:
    """Return a domain that no participant of this host uses, and keep it from other tests for a while."""
    for domain in random.sample(range(1, DOMAINS + 1), DOMAINS):
        base = 7400 + 250 * domain
        participants = [_bind(base + 10 + 2 * index) for index in range(PROBED_PARTICIPANTS)]
        for probe in participants:
            if probe:
                probe.close()
        if not all(participants) or (held := _bind(base + HELD_PORT)) is None:
            continue
        if len(_held) == _held.maxlen:
            _held[0].close()
        _held.append(held)
        return domain
    raise AssertionError("all ROS domains are in use on this host")


def _bind(port: int) -> socket.socket | None:
    probe = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        probe.bind(("", port))
    except OSError:
        probe.close()
        return None
    return probe
