"""Time that the stages of a call took."""

from __future__ import annotations

import time


class StageTimer:
    """Sums the time of each stage of one call: `with timer("align"): ...`; a stage holds no other one.

    Attributes:
        seconds: Time of each stage by name.
    """

    def __init__(self) -> None:
        """Start without stages."""
        self.seconds: dict[str, float] = {}
        self._name, self._start = "", 0.0

    def __call__(self, name: str) -> StageTimer:
        """Name the stage of a block."""
        self._name = name
        return self

    def __enter__(self) -> None:
        """Begin the stage."""
        self._start = time.perf_counter()

    def __exit__(self, *_: object) -> None:
        """End the stage, also where it raised."""
        self.seconds[self._name] = self.seconds.get(self._name, 0.0) + time.perf_counter() - self._start
