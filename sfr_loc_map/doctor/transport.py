"""Messages lost in transport: from which share on, and what to do. Doctor and nodes give the same advice."""

from __future__ import annotations

MUCH_LOST = 0.1  #: Share lost above which the transport is not set up for the messages


def loss_fix(export_line: str) -> str:
    """Return what to do about messages that are lost between two processes of a host."""
    return (
        f"start the process that publishes them (the camera driver) with "
        f"`{export_line}`: its shared memory counts, and holds 0.5 MB unless set; "
        "a container with --net=host needs --ipc=host"
    )
