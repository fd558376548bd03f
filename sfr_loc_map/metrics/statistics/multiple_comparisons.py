"""Many comparisons at once: each probability corrected for their number."""

from __future__ import annotations

from collections.abc import Sequence


def holm(probabilities: Sequence[float | None]) -> list[float | None]:
    """Return probabilities corrected for their number (Holm 1979); None stays and does not count."""
    known = sorted((value, index) for index, value in enumerate(probabilities) if value is not None)
    corrected: list[float | None] = [None] * len(probabilities)
    largest = 0.0
    for rank, (value, index) in enumerate(known):
        largest = max(largest, min(1.0, value * (len(known) - rank)))
        corrected[index] = largest
    return corrected
