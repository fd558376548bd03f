"""A bounded memory of values that wait for their counterparts."""

from __future__ import annotations

from collections import OrderedDict
from typing import TypeVar

K = TypeVar("K")
V = TypeVar("V")


class Latest(OrderedDict[K, V]):
    """The values that were set last, by key; the oldest are dropped."""

    def __init__(self, count: int) -> None:
        """Set the maximum number of values."""
        super().__init__()
        self._count = count

    def __setitem__(self, key: K, value: V) -> None:
        super().__setitem__(key, value)
        self.move_to_end(key)
        while len(self) > self._count:
            self.popitem(last=False)
