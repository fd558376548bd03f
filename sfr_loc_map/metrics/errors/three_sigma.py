"""What mean + 3 sigma of the observed position errors proves about the distribution of all position errors."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.metrics.figures.rows import Figure, figure_row
from sfr_loc_map.metrics.statistics.tolerance import THREE_SIGMA, Sample, confidence_of, moments

FRACTIONS = (THREE_SIGMA, 0.95)  #: Fractions of the errors for which a report states the confidence of mean + 3 sigma.


def confidence_rows(condition: str, errors: FloatArray, overlap: float) -> Iterator[Figure]:
    """Yield the confidence of mean + 3 sigma of position errors, and the shape and normality of their distribution."""
    sample = Sample(errors, len(errors) / max(overlap, 1.0))
    known = moments(sample)
    counts: dict[str, Any] = {"n": len(errors), "independent": sample.independent}
    for prob in FRACTIONS:
        value = None if known is None else confidence_of(3.0, sample.independent, known.shape, prob)
        yield figure_row("confidence", condition, f"{100.0 * prob:g} % of position errors", value=value, **counts)
    shape = () if known is None else known.shape
    for axis, name in enumerate(("second", "third"), 1):
        ratio = shape[axis] / shape[0] if len(shape) > axis and shape[0] > 0.0 else None
        yield figure_row("shape", condition, f"{name} principal axis", value=ratio, **counts)
    yield figure_row("normality", condition, value=None if known is None else known.significance, **counts)
