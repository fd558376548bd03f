"""A subscription to true poses, whose type is that of their publisher."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from sfr_loc_map.io.truth.messages import TRUTH_TYPES
from sfr_loc_map.message_types import ODOMETRY


class TruthSubscription:
    """Subscribes to true poses with the published type, because a process can use only one type per topic."""

    def __init__(self, subscribe: Callable[[str], Callable[[], object]], msgtype: str = ODOMETRY) -> None:
        """Begin with a type; `subscribe` subscribes with a type and returns the function that unsubscribes."""
        self.msgtype = msgtype
        self._subscribe = subscribe
        self._unsubscribe = subscribe(msgtype)

    def follow(self, published: Sequence[str]) -> bool:
        """Change to a published type of true poses unless the present type is published; return whether it changed."""
        usable = [msgtype for msgtype in published if msgtype in TRUTH_TYPES]
        if not usable or self.msgtype in usable:
            return False
        self._unsubscribe()
        self.msgtype = usable[0]
        self._unsubscribe = self._subscribe(self.msgtype)
        return True
