"""Limits of losses and of clocks in transport, and what to do about losses; doctor and nodes share them."""

from __future__ import annotations

from sfr_loc_map.inputs import NS_PER_S

MUCH_LOST = 0.1  #: Fraction of lost messages above which the transport is not set up for them.
COMPARABLE_NS = 60 * NS_PER_S
"""Largest difference of two clocks that are compared. A recording that is played, or a host whose clock is not set, has
a larger one."""


def loss_fix(export_line: str) -> str:
    """Return what to do about messages that are lost between two processes of a host."""
    return (
        f"start the process that publishes them (the camera driver) with "
        f"`{export_line}`: its shared memory counts, and holds 0.5 MB unless set; "
        "a container with --net=host needs --ipc=host"
    )
