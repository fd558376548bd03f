"""The path travelled so far, in a bounded number of poses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Generic, TypeVar

import numpy as np

from sfr_loc_map.geometry.transform import Transform

P = TypeVar("P")
MAX_POSES = 2000
FIRST_SPACING_M = 0.02
TURN_PER_METRE = math.radians(100.0)
"""A turn of so much counts as a metre: a rover that turns on the spot leaves poses as well."""


class ThinnedPath(Generic[P]):
    """Keeps poses at a spacing that doubles when there would be too many; the first and the last one always stay."""

    def __init__(self, max_poses: int = MAX_POSES) -> None:
        """Start empty; `max_poses` is at least 3."""
        self._max_poses = max_poses
        self.clear()

    def clear(self) -> None:
        """Start a new path."""
        self._kept: list[tuple[Transform, P]] = []
        self._last: tuple[Transform, P] | None = None
        self._last_ns: int | None = None
        self._spacing_m = FIRST_SPACING_M

    @property
    def poses(self) -> Sequence[P]:
        """What was given with the poses that are left, in order."""
        kept = [item for _, item in self._kept]
        if self._last is not None and (not self._kept or self._last is not self._kept[-1]):
            kept.append(self._last[1])
        return kept

    def add(self, stamp_ns: int, pose: Transform, item: P) -> None:
        """Add a pose; a stamp that is not later than the last one starts a new path.

        Args:
            stamp_ns: Its stamp.
            pose: The pose.
            item: What stands for it, such as its message.
        """
        if self._last_ns is not None and stamp_ns <= self._last_ns:
            self.clear()
        self._last, self._last_ns = (pose, item), stamp_ns
        if not self._kept or _distance(self._kept[-1][0], pose) >= self._spacing_m:
            self._kept.append(self._last)
        if len(self._kept) >= self._max_poses:
            self._kept = self._kept[::2]
            self._spacing_m *= 2.0


def _distance(before: Transform, now: Transform) -> float:
    """Return how far apart two poses are, metres; the angle is that of the trace, `1 + 2 cos`."""
    cosine = 0.5 * (float(np.vdot(before.rotation, now.rotation)) - 1.0)
    return math.dist(before.translation, now.translation) + math.acos(max(-1.0, min(1.0, cosine))) / TURN_PER_METRE
