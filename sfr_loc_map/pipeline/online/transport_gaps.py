"""What the transport lost, from the numbers that publishers give their messages."""

from __future__ import annotations

from typing import Any


class TransportGaps:
    """Counts what was published on a topic and did not come, for topics with one publisher at a time.

    A publisher numbers its messages from 1, so that one that begins anew has a lower number; who it is does not come
    with them.

    Attributes:
        lost: Messages missing so far.
    """

    def __init__(self) -> None:
        """Start with a topic of which nothing has come."""
        self.lost = self._last = 0

    def came(self, info: dict[str, Any]) -> None:
        """Note a message.

        Args:
            info: What rclpy knows of it; a middleware that does not number messages loses none that we know of.
        """
        number = int(info.get("publication_sequence_number") or 0)
        if self._last and number > self._last:
            self.lost += number - self._last - 1
        self._last = number
