"""The scales on which the kinds of figures are compared from night to night: logarithm, count or identity."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.suite.statistics.figures import ComparedKind


@dataclass(frozen=True, slots=True)
class Scale:
    """Scale on which a kind of figure is compared."""

    apply: Callable[[FloatArray], FloatArray]  #: Converts values to the scale; NaN if undefined.
    #: Converts a mean on the scale to the reported mean; None if the reported mean is that of the values.
    undo: Callable[[float], float] | None
    floor: float  #: Minimum standard deviation of a job from night to night.
    of_host: bool = False  #: Whether the figure depends on the host, which all jobs of a night share.


def log_scale(floor: float, *, of_host: bool = False) -> Scale:
    """Return the scale of positive values, whose logarithms are compared; values that are not positive are missing."""
    return Scale(lambda x: np.log(np.where(x > 0.0, x, np.nan)), lambda value: float(np.exp(value)), floor, of_host)


COUNT = Scale(lambda x: 2.0 * np.sqrt(x + 0.375), None, 1.0)
"""Scale of a count n: `2 sqrt(n + 3/8)`, whose standard deviation is about 1 for Poisson counts (Anscombe 1948).

The scale is for the test only, because a mean of roots is far below the mean of counts that differ between jobs.
"""
#: The minimum standard deviations (`Scale.floor`) were chosen by hand: 5 % of an error or a time, 10 % of a NEES, 2 %
#: of memory, and 10 % of the jobs.
SCALES: Mapping[ComparedKind, Scale] = {
    ComparedKind.ACCURACY: log_scale(0.05),
    ComparedKind.NEES: log_scale(0.1),
    ComparedKind.LOST: COUNT,
    ComparedKind.DEGRADED: COUNT,
    ComparedKind.MISSING: COUNT,
    ComparedKind.FAILED: Scale(np.copy, float, 0.1),
    ComparedKind.TIME: log_scale(0.05, of_host=True),
    ComparedKind.MEMORY: log_scale(0.02, of_host=True),
}
