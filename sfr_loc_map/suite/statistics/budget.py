"""Error budget of a scenario: the contribution of each error source to the position error.

Each drive is simulated and localised in all variants (`suite/planning/variants.py`). Independent errors add in the
mean square. The fractions of a source s are therefore

    alone       = (m(only s) - m(none)) / m(all)        first-order fraction
    removed     = (m(all) - m(all but s)) / m(all)      fraction that vanishes without s
    interaction = removed - alone                       fraction that s causes together with other sources

where m is the mean of |e|^2 over all sub-trajectories: the squared mean plus the variance, summed over the axes, as
ECSS-E-ST-60-10C adds errors (4.2). The rest `m(none) / m(all)` is the fraction due to sources that the budget does not
name. If the named sources do not interact, the fractions `alone` and the rest add up to 1. The sum is reported with its
interval.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.metrics.figures.catalogue import KINDS
from sfr_loc_map.metrics.figures.rows import Figure
from sfr_loc_map.suite.jobs.job import Job
from sfr_loc_map.suite.planning.variants import ALL, NONE, error_sources_of, variant_name
from sfr_loc_map.suite.statistics.pooling import rows_by_axis
from sfr_loc_map.suite.statistics.resampling import MIN_DRIVES, drawn_weights, half_width
from sfr_loc_map.suite.statistics.scored_job import ScoredJob


@dataclass(frozen=True, slots=True)
class BudgetFigure:
    """A figure of the budget and its 95 % interval."""

    value: float | None = None  #: None if unknown.
    ci95: tuple[float, float] | None = None  #: None for fewer than `MIN_DRIVES` drives.


@dataclass(frozen=True, slots=True, kw_only=True)
class BudgetRow:
    """Contribution of an error source."""

    source: str  #: Name of the source of error.
    alone: BudgetFigure  #: First-order fraction of the mean square.
    removed: BudgetFigure  #: Fraction of the mean square that vanishes without the source.
    interaction: BudgetFigure  #: `removed` less `alone`.
    mean_m: tuple[float, ...] | None  #: Mean error by axis due to the source alone.
    sigma_m: tuple[float, ...] | None  #: Root of the variance by axis that the source alone adds, at least 0.


@dataclass(frozen=True, slots=True, kw_only=True)
class Budget:
    """The error budget for a condition of the sub-trajectories."""

    configuration: str
    condition: str
    drives: int  #: Drives with results of all variants.
    left_out: int  #: Drives that lack the result of a variant.
    rms_m: float | None  #: Root mean square error with all sources.
    rows: tuple[BudgetRow, ...]
    rest: BudgetFigure  #: Fraction due to sources that the budget does not name.
    total: BudgetFigure  #: Sum of the fractions `alone` and the rest; 1 if the sources do not interact.


def budget_of(
    error_sources: Sequence[str],
    condition: str,
    sums: Mapping[str, Mapping[str, FloatArray]],
    *,
    configuration: str = "default",
) -> Budget:
    """Return the budget of the `sums_of_errors` of each variant and drive; drives that lack a variant are omitted.

    `error_sources` are the names of the sources of error, in the order of the suite's file.
    """
    alone_in = {name: variant_name({name}, error_sources) for name in error_sources}
    missing_in = {name: variant_name(set(error_sources) - {name}, error_sources) for name in error_sources}
    needed = list(dict.fromkeys([ALL, NONE, *alone_in.values(), *missing_in.values()]))
    begun = sorted({drive for name in needed for drive in sums.get(name, {})})
    drives = [drive for drive in begun if all(drive in sums.get(name, {}) for name in needed)]
    budget = Budget(
        configuration=configuration,
        condition=condition,
        drives=len(drives),
        left_out=len(begun) - len(drives),
        rms_m=None,
        rows=tuple(row_with_fraction(name, BudgetFigure()) for name in error_sources),
        rest=BudgetFigure(),
        total=BudgetFigure(),
    )
    if not drives:
        return budget
    drawn = _weights(len(drives))
    moments = {name: _moments(drawn @ np.array([sums[name][drive] for drive in drives])) for name in needed}
    whole, none = moments[ALL], moments[NONE]
    rest = none.mean_square / whole.mean_square
    total = rest.copy()
    rows = []
    for name in error_sources:
        only, without = moments[alone_in[name]], moments[missing_in[name]]
        alone = (only.mean_square - none.mean_square) / whole.mean_square
        removed = (whole.mean_square - without.mean_square) / whole.mean_square
        total += alone
        variance = np.maximum(only.variance[0] - none.variance[0], 0.0)
        rows.append(
            BudgetRow(
                source=name,
                alone=_figure(alone, len(drives)),
                removed=_figure(removed, len(drives)),
                interaction=_figure(removed - alone, len(drives)),
                mean_m=tuple((only.mean[0] - none.mean[0]).tolist()),
                sigma_m=tuple(np.sqrt(variance).tolist()),
            )
        )
    return replace(
        budget,
        rms_m=float(np.sqrt(whole.mean_square[0])),
        rows=tuple(rows),
        rest=_figure(rest, len(drives)),
        total=_figure(total, len(drives)),
    )


class _Moments(NamedTuple):
    """Moments of all errors of a variant, for the original drives and for R resamplings."""

    mean_square: FloatArray  #: `(1 + R,)`, m^2.
    mean: FloatArray  #: Mean by axis `(1 + R, 3)`, m.
    variance: FloatArray  #: Variance by axis `(1 + R, 3)`, m^2.


def _moments(sums: FloatArray) -> _Moments:
    """Return the moments of weighted `sums_of_errors` `(1 + R, 7)`."""
    count, total, squares = sums[:, :1], sums[:, 1:4], sums[:, 4:]
    mean = total / count
    variance = (squares - count * np.square(mean)) / np.maximum(count - 1.0, 1.0)
    return _Moments((squares / count).sum(axis=1), mean, variance)


def _weights(drives: int) -> FloatArray:
    """Return the weights of the drives: a row of ones, then a row for each resampling if there is an interval."""
    once = np.ones((1, drives))
    return once if drives < MIN_DRIVES else np.vstack([once, drawn_weights(drives)])


def _figure(values: FloatArray, drives: int) -> BudgetFigure:
    """Return a figure with its interval from its value and the values of the resamplings `(1 + R,)`."""
    value = float(values[0])
    if len(values) == 1:
        return BudgetFigure(value)
    half = half_width(values[1:], drives)
    return BudgetFigure(value, (value - half, value + half))


def row_with_fraction(error_source: str, alone: BudgetFigure) -> BudgetRow:
    """Return a row whose other figures are unknown."""
    unknown = BudgetFigure()
    return BudgetRow(source=error_source, alone=alone, removed=unknown, interaction=unknown, mean_m=None, sigma_m=None)


def budgets_of(results: Sequence[ScoredJob], planned: Sequence[Job]) -> Iterator[Budget]:
    """Yield the error budget of each configuration and condition; nothing if the suite is not a budget."""
    error_sources = error_sources_of([job.variant for job in planned])
    if not error_sources:
        return
    for configuration in dict.fromkeys(result.job.configuration for result in results):
        used = [result for result in results if result.job.configuration == configuration and result.job.repeat == 0]
        for condition in dict.fromkeys(condition for result in used for condition in result.score.conditions):
            sums: dict[str, dict[str, FloatArray]] = {}
            for result in used:
                rows = rows_by_axis(result.score, KINDS["position"], condition)
                if rows and all(row.mean is not None and row.sigma is not None for row in rows):  # two errors or more
                    sums.setdefault(result.job.variant, {})[result.job.source.name] = sums_of_errors(rows)
            yield budget_of(error_sources, condition, sums, configuration=configuration)


def sums_of_errors(rows: Sequence[Figure]) -> FloatArray:
    """Return the additive moments `(7,)` of a drive: number of errors, sums by axis, sums of squares by axis.

    `rows` are the statistics of the errors along each axis, in m.
    """
    n = rows[0].n or 0
    mean = np.array([row.mean for row in rows], np.float64)
    sigma = np.array([row.sigma for row in rows], np.float64)  # with the divisor n - 1
    squares = n * np.square(mean) + (n - 1) * np.square(sigma)
    return np.concatenate([[n], n * mean, squares])
