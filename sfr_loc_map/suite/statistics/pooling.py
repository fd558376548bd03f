"""Errors pooled over drives: mean, sigma and interval of the sub-trajectories of all drives.

The sub-trajectories of a group are one sample, as the statistics of the specification require [4.1.3]. Count, mean and
sigma of all values follow exactly from those of the drives (Chan, Golub, LeVeque 1983). The 95 % interval resamples
whole drives, because errors within one drive are not independent.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.metrics.figures.catalogue import KINDS, FigureKind
from sfr_loc_map.metrics.figures.row_part import POOLED
from sfr_loc_map.metrics.figures.rows import Figure, figure_row
from sfr_loc_map.metrics.figures.subjects import Subject
from sfr_loc_map.metrics.formulas import mean_plus_3sigma
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.suite.statistics.resampling import MIN_DRIVES, drawn_weights, half_width
from sfr_loc_map.suite.statistics.scored_job import ScoredJob

FIGURE_OF_AXES = "position"  #: Figure whose rows are the components of error vectors.


AxisRows: TypeAlias = Sequence[Figure]
"""A figure of a result: the rows of its axes, or the judged row of a figure without axes."""


def pool(results: Sequence[ScoredJob], condition: str) -> Iterator[Figure]:
    """Yield the pooled errors of results for a condition.

    Means and sigmas of a vector are pooled axis by axis. Of several sources that are copies of one drive, only the
    worst is pooled, because copies would dilute the errors.
    """
    for kind in KINDS.values():
        if kind.subject is not Subject.TRAJECTORY:
            continue
        with_figure = [result for result in results if result.score.rows(kind.name, condition=condition)]
        by_source: dict[tuple[str, str], list[AxisRows]] = {}
        for result in with_figure:
            rows = rows_by_axis(result.score, kind, condition)
            if rows and all(row.mean is not None and (row.n or 0) > 0 for row in rows):
                by_source.setdefault((result.drive_key, result.job.source.sha256), []).append(rows)
        if with_figure:
            yield pooled_row(kind.name, condition, _without_copies(kind.name, condition, by_source))


def _without_copies(
    figure: str, condition: str, by_source: Mapping[tuple[str, str], Sequence[AxisRows]]
) -> dict[str, Sequence[AxisRows]]:
    """Return the results of the worst source of each drive. The repeats are given by drive and source."""
    worst: dict[str, tuple[float, Sequence[AxisRows]]] = {}
    for (drive_key, _), repeats in by_source.items():
        size = pooled_row(figure, condition, {drive_key: repeats}).mean_plus_3sigma
        if size is None:
            size = float(np.linalg.norm([row.mean or 0.0 for row in repeats[0]]))
        if drive_key not in worst or size > worst[drive_key][0]:
            worst[drive_key] = size, repeats
    return {drive_key: repeats for drive_key, (_, repeats) in worst.items()}


def rows_by_axis(score: Score, kind: FigureKind, condition: str) -> list[Figure]:
    """Return the row of each axis of a vector, or the judged row of a scalar; empty if a row is missing.

    The axes of a vector are parts of the figure `position` (`FigureKind.axes`): `horizontal` has those for x and y.
    """
    if kind.axes:
        rows = [score.figure(FIGURE_OF_AXES, condition=condition, part=axis) for axis in kind.axes]
    else:
        rows = [score.judged_row(kind.name, condition=condition)]
    found = [row for row in rows if row is not None]
    return found if len(found) == len(rows) else []


def pooled_row(figure: str, condition: str, drives: Mapping[str, Sequence[AxisRows]]) -> Figure:
    """Return mean, sigma and mean + 3 sigma of all values of the results, which are given for each drive.

    The row has no quantiles, because the quantiles of all values do not follow from the quantiles of the drives. The
    interval resamples drives, each with all of its results. `independent` is the number of drives.
    """
    results = [rows for of_drive in drives.values() for rows in of_drive]
    many = len(drives)
    count = np.array([float(rows[0].n or 0) for rows in results])
    total = int(count.sum())
    if not results:
        return figure_row(figure, condition, POOLED, n=0, independent=0)
    means = np.array([[row.mean for row in rows] for rows in results], np.float64)
    if total < 2:
        return figure_row(figure, condition, POOLED, n=total, independent=many)
    sigmas = np.array([[row.sigma or 0.0 for row in rows] for rows in results], np.float64)
    squares = np.square(sigmas) * (count[:, None] - 1.0)
    mean, sigma = (float(values[0]) for values in _pooled(count, means, squares, np.ones((1, len(count)))))
    found: dict[str, Any] = {"mean": mean, "sigma": sigma, "mean_plus_3sigma": mean_plus_3sigma(mean, sigma)}
    if means.shape[1] == 1:  # the mean of a scalar figure keeps its sign
        found["mean"] = float(count @ means[:, 0]) / total
    if many >= MIN_DRIVES and found["mean_plus_3sigma"] > 0.0:
        numbers = np.repeat(np.arange(many), [len(of_drive) for of_drive in drives.values()])  # drive of each result
        weights = drawn_weights(many)[:, numbers]
        drawn_means, drawn_sigmas = _pooled(count, means, squares, weights)
        logs = np.log(np.maximum(mean_plus_3sigma(drawn_means, drawn_sigmas), 1e-300))
        factor = float(np.exp(half_width(logs, many)))
        found["low95"], found["high95"] = found["mean_plus_3sigma"] / factor, found["mean_plus_3sigma"] * factor
    return figure_row(figure, condition, POOLED, n=total, independent=many, **found)


def _pooled(
    count: FloatArray, means: FloatArray, squares: FloatArray, weights: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the norms of mean and sigma `(R,)` of all values, with weights `(R, D)` of the results.

    The results are given by counts `(D,)`, means `(D, d)` and sums of squared deviations from the means `(D, d)`.
    """
    total = weights @ count
    mean = (weights @ (count[:, None] * means)) / total[:, None]
    # moments about the unweighted common mean, to avoid cancellation
    centre = (count[:, None] * means).sum(axis=0) / count.sum()
    second = weights @ (squares + count[:, None] * np.square(means - centre))
    deviations = second - total[:, None] * np.square(mean - centre)
    sigma = np.sqrt(np.maximum(deviations, 0.0) / (total[:, None] - 1.0))
    return np.sqrt(np.square(mean).sum(axis=1)), np.sqrt(np.square(sigma).sum(axis=1))
