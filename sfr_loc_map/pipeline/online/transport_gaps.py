"""Messages lost in transport, from the sequence numbers of their publishers."""

from __future__ import annotations

from typing import Any


class TransportGaps:
    """Counts messages that were published but not received, for topics with one publisher at a time.

    A publisher numbers its messages from 1, so a lower number is a new publisher; its identity is not transmitted.

    Attributes:
        lost: Messages missing so far.
    """

    def __init__(self) -> None:
        """Start with a topic of which nothing was received."""
        self.lost = self._last = 0

    def add(self, info: dict[str, Any]) -> None:
        """Count the gap before a message.

        Args:
            info: Its message info of rclpy; without a sequence number no loss is counted.
        """
        number = int(info.get("publication_sequence_number") or 0)
        if self._last and number > self._last:
            self.lost += number - self._last - 1
        self._last = number
