"""Limits in plots: a line for each limit, and an axis that shows values beside their limits."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from sfr_loc_map.report.plots import Trace, Values, axis, largest, line, log_axis, scaled, span
from sfr_loc_map.report.plotted_data import PlottedLimit

LOGARITHMIC_ABOVE = 3.0  #: A limit above this multiple of the largest value makes an axis of sizes logarithmic.


def limit_lines(
    limits: Sequence[PlottedLimit],
    ends: Values,
    factor: float = 1.0,
    of: str = "",
    hidden_above: float = math.inf,
    **more: Any,  # noqa: ANN401
) -> list[Trace]:
    """Return a line for each limit in the unit of the plot; `of` names the limited errors in the legend.

    A limit beyond `hidden_above` is only in the legend.
    """
    traces = []
    for limit in limits:
        far = {"visible": "legendonly"} if abs(limit.value * factor) > hidden_above else {}
        title = f"{limit.title}, {of}" if of else limit.title
        level = scaled([limit.value] * 2, factor)
        traces.append(line(title, (ends, level), "@bad", dash="longdash", **(more | far)))
    return traces


def error_axis(title: str, values: Values, limits: Sequence[float]) -> dict[str, Any]:
    """Return an axis from 0 for values and their limits; logarithmic if a limit is far above all values.

    A logarithmic axis cannot show a value of 0.
    """
    has_zero = any(value == 0.0 for value in values)
    if not has_zero and max(limits, default=0.0) > LOGARITHMIC_ABOVE * largest(values):
        return log_axis(title, *span([*values, *limits]))
    return axis(title, rangemode="tozero")
