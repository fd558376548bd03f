"""What a process needs before and when it starts ROS: environment variables, a domain, `rclpy.init`."""

from __future__ import annotations

import ctypes
import fcntl
import os
import random
import socket
import sys
import time
from collections import deque
from collections.abc import MutableMapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from sfr_loc_map.errors import NodeError

PROFILE = Path(__file__).with_name("profiles") / "fastdds_shm.xml"
"""Fast DDS profile with a shared-memory segment that holds large images and clouds."""
PROFILE_VARIABLE = "FASTRTPS_DEFAULT_PROFILES_FILE"
EXPORT_LINE = f"export {PROFILE_VARIABLE}={PROFILE}"  #: What a camera driver's shell needs.
DOMAINS = 101  #: Domains 1 to 101 have ports below the ephemeral range.
PROBED_PARTICIPANTS = 10  #: The first of a domain may have ended while others run.
HELD_PORT = 249  #: From the first port of a domain: that of participant 119, which no program reaches.
KEPT = 16  #: Most domains that one process holds.
SHARED_MEMORY = Path("/dev/shm")
SEGMENT_AGE_S = 0.1  #: Fast DDS locks a lock file microseconds after it has made it.
_held: deque[socket.socket] = deque(maxlen=KEPT)


def prepare(environment: MutableMapping[str, str] = os.environ) -> None:
    """Set missing variables; those that the user has set stay.

    An empty profile variable counts as not set: Fast DDS would report it as a broken file. The pip wheels of ROS do not
    set the path of their package index.
    """
    if not environment.get(PROFILE_VARIABLE):
        environment[PROFILE_VARIABLE] = str(PROFILE)
    environment.setdefault("AMENT_PREFIX_PATH", sys.prefix)


def isolate(environment: MutableMapping[str, str] = os.environ) -> None:
    """Choose a domain that no running program uses and stay on this host, unless the user chose."""
    if not environment.get("ROS_DOMAIN_ID"):
        environment["ROS_DOMAIN_ID"] = str(free_domain())
    if not environment.get("ROS_LOCALHOST_ONLY"):
        environment.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")


def free_domain() -> int:
    """Return a domain that no participant of this host uses, and keep it from other processes that ask for one.

    Ports are those of RTPS (OMG DDSI-RTPS 2.5, 9.6.2.3): 7400 + 250 domain, and from there 10 + 2 i for participant i.
    The participants come seconds after the choice: until then a port of the domain that they do not reach is held. It
    is given back at the end of this process, or after more calls.

    Raises NodeError if all are in use.
    """
    for domain in random.sample(range(1, DOMAINS + 1), DOMAINS):
        base = 7400 + 250 * domain
        participants = [_bind(base + 10 + 2 * index) for index in range(PROBED_PARTICIPANTS)]
        for probe in participants:
            if probe:
                probe.close()
        if not all(participants) or (held := _bind(base + HELD_PORT)) is None:
            continue
        if len(_held) == KEPT:
            _held[0].close()
        _held.append(held)
        return domain
    raise NodeError(
        f"all ROS domains 1 to {DOMAINS} are in use on this host: end other ROS programs or set ROS_DOMAIN_ID"
    )


def _bind(port: int) -> socket.socket | None:
    """Return a UDP socket on a port of all interfaces, None where it is in use."""
    probe = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        probe.bind(("", port))
    except OSError:
        probe.close()
        return None
    return probe


def remove_dead_segments() -> None:
    """Remove the shared memory of Fast DDS, 64 MB each by our profile, whose process was killed.

    Fast DDS holds the lock file of each segment (`fastrtps_ID_el`) and port (`fastrtps_portN_el`) while it uses it.
    """
    for lock in SHARED_MEMORY.glob("fastrtps_*_el"):
        with suppress(OSError), lock.open("rb") as stream:  # of another user, or in use
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if time.time() - lock.stat().st_ctime > SEGMENT_AGE_S:
                name = lock.name.removesuffix("_el")
                for path in (lock.with_name(name), lock.with_name(f"sem.{name}_mutex"), lock):
                    path.unlink(missing_ok=True)


def configure_malloc() -> None:
    """Make glibc return large blocks at once and use one arena for all small ones; does nothing elsewhere.

    For a process that runs for hours: blocks that one thread allocates and another frees fragment the heap (a monitor
    at 50 Hz then grows by twice what it keeps). Call it before other threads are started.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform.startswith("linux") else None
    if mallopt is not None:
        mallopt(-3, 131_072)  # M_MMAP_THRESHOLD
        mallopt(-8, 1)  # M_ARENA_MAX


def start_ros(arguments: Sequence[str] = (), *, signals: bool = False) -> None:
    """Start ROS with a command line; signals stay with the program unless ROS is to shut down by them.

    Raises NodeError if it does not start: bad arguments or parameter files, a log folder that cannot be written.
    """
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    options: dict[str, Any] = {} if signals else {"signal_handler_options": SignalHandlerOptions.NO}
    prepare()
    remove_dead_segments()
    try:
        rclpy.init(args=list(arguments), **options)
    except Exception as error:  # rclpy's classes for these share no root
        raise NodeError(f"ROS does not start with these arguments and settings: {error}") from error
