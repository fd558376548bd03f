"""Limits of transport losses and clock differences, and the fix for losses, for doctor and nodes."""

from __future__ import annotations

from sfr_loc_map.inputs import NS_PER_S

MUCH_LOST = 0.1  #: Fraction of lost messages above which the transport is not configured for them.
COMPARABLE_NS = 60 * NS_PER_S
"""Largest difference between comparable clocks, ns. A played recording, or a host whose clock is not set, exceeds this
difference."""


def loss_fix(export_line: str) -> str:
    """Return the fix for messages that are lost between two processes of a host."""
    return (
        f"start the process that publishes them (the camera driver) with "
        f"`{export_line}`: the default shared memory of the publisher is 0.5 MB; "
        "a container with --net=host needs --ipc=host"
    )
