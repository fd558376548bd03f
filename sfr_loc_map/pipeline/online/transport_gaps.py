"""Messages lost in transport, from the sequence numbers of their publishers, and what to do about them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

LOSS_WINDOW = 40
"""Messages of which the share lost is taken."""
MUCH_LOST = 0.1
"""Share lost above which the transport is not set up for the messages."""


class TransportGaps:
    """Counts messages that were published but not received, for topics with one publisher at a time.

    A publisher numbers its messages from 1, so a lower number is a new publisher; its identity is not transmitted.

    Attributes:
        lost: Messages missing so far.
    """

    def __init__(self) -> None:
        """Start with a topic of which nothing was received."""
        self.lost = self._last = 0

    def add(self, info: dict[str, Any]) -> int:
        """Count the gap before a message, and return it.

        Args:
            info: Its message info of rclpy; without a sequence number no loss is counted.
        """
        number, last = int(info.get("publication_sequence_number") or 0), self._last
        self._last = number
        gap = number - last - 1 if last and number > last else 0
        self.lost += gap
        return gap


class LossWatch:
    """Says when a large share of the messages of a transport is lost."""

    def __init__(self, what: str, export_line: str, warn: Callable[[str], None]) -> None:
        """Begin.

        Args:
            what: What the messages are, in the plural.
            export_line: Line of a shell that gives the publisher the memory it should have.
            warn: Called with the share and what to do.
        """
        self._what, self._export_line, self._warn = what, export_line, warn
        self._lost = self._sent = 0

    def add(self, gap: int) -> None:
        """Count a message that was received, and those lost before it."""
        self._lost += gap
        self._sent += gap + 1
        if self._sent < LOSS_WINDOW:
            return
        share, self._lost, self._sent = self._lost / self._sent, 0, 0
        if share > MUCH_LOST:
            self._warn(f"{share:.0%} of the {self._what} are lost in transport: {loss_fix(self._export_line)}")


def loss_fix(export_line: str) -> str:
    """Return what to do about messages that are lost between two processes of a host.

    Args:
        export_line: Names the profile of Fast DDS.
    """
    return (
        f"start the process that publishes them (the camera driver) with "
        f"`{export_line}`: its shared memory counts, and holds 0.5 MB unless set"
    )
