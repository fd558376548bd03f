"""A path with a bounded number of poses, for displays."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Generic, TypeVar

import numpy as np

from sfr_loc_map.geometry.transform import Transform

T = TypeVar("T")
MAX_POSES = 2000  #: Maximum number of poses of a thinned path: about the width of a figure in pixels.
FIRST_SPACING_M = 0.02  #: Initial spacing of a thinned path, metres: 1000 poses in 20 m.
TURN_PER_METRE = math.radians(100.0)
"""Rotation that counts as 1 m of path, rad, so that point turns also add poses."""


class ThinnedPath(Generic[T]):
    """Keeps poses at a spacing that doubles each time `max_poses` are kept; the first and the last pose are kept."""

    def __init__(self, max_poses: int = MAX_POSES) -> None:
        """Start empty; `max_poses` is at least 3."""
        self._max_poses = max_poses
        self.clear()

    def clear(self) -> None:
        """Start a new path."""
        self._kept: list[tuple[Transform, T]] = []
        self._last: tuple[Transform, T] | None = None
        self._last_ns: int | None = None
        self._spacing_m = FIRST_SPACING_M

    @property
    def poses(self) -> Sequence[T]:
        """The items of the kept poses, in order."""
        kept = [item for _, item in self._kept]
        if self._last is not None and (not self._kept or self._last is not self._kept[-1]):
            kept.append(self._last[1])
        return kept

    def add(self, stamp_ns: int, pose: Transform, item: T) -> None:
        """Add a pose and its item; a stamp that does not exceed the last stamp starts a new path."""
        if self._last_ns is not None and stamp_ns <= self._last_ns:
            self.clear()
        self._last = (pose, item)
        self._last_ns = stamp_ns
        if not self._kept or _distance(self._kept[-1][0], pose) >= self._spacing_m:
            self._kept.append(self._last)
        if len(self._kept) >= self._max_poses:
            self._kept = self._kept[::2]
            self._spacing_m *= 2.0


def _distance(before: Transform, now: Transform) -> float:
    """Return the distance between two poses, m: the translation plus the rotation angle divided by `TURN_PER_METRE`."""
    cosine = 0.5 * (float(np.vdot(before.rotation, now.rotation)) - 1.0)
    return math.dist(before.translation, now.translation) + math.acos(max(-1.0, min(1.0, cosine))) / TURN_PER_METRE
