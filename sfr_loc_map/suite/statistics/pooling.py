"""Errors pooled over drives: mean, sigma and interval of the sub-trajectories of all drives.

The sub-trajectories of a group are one sample, as the statistics of the specification require [4.1.3]. Count, mean and
sigma of all values follow exactly from those of the drives (Chan, Golub, LeVeque 1983). The 95 % interval resamples
whole drives, because errors within one drive are not independent.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.metrics.catalogue import KINDS, Subject
from sfr_loc_map.metrics.formulas import mean_plus_3sigma
from sfr_loc_map.metrics.score import Score
from sfr_loc_map.metrics.table import POOLED, Figure, figure_row
from sfr_loc_map.suite.statistics.resampling import MIN_DRIVES, drawn_weights, half_width

AXES = ("x", "y", "z")  #: Pooled parts of the position error.


def pool(results: Sequence[tuple[str, Score]], condition: str, sources: Sequence[str] = ()) -> Iterator[Figure]:
    """Yield the pooled errors of scores for a condition; each score is given with the key of its drive.

    Means and sigmas of a vector are pooled axis by axis. `sources` are the hashes of the sources of the results. Of the
    sources that are copies of one drive, only the worst is pooled, because copies would dilute the errors.
    """
    for kind in KINDS.values():
        if kind.subject is not Subject.TRAJECTORY:
            continue
        axes: tuple[str | None, ...] = AXES if kind.name == "position" else (None,)
        used: dict[tuple[str, str], list[list[Figure]]] = {}
        for (drive, score), source in zip(results, sources or [""] * len(results), strict=True):
            rows = [axis_row(score, kind.name, condition, axis) for axis in axes]
            known = [row for row in rows if row is not None and row.mean is not None and (row.n or 0) > 0]
            if len(known) == len(axes):
                used.setdefault((drive, source), []).append(known)
        has_figure = any(score.rows(kind.name, condition=condition) for _, score in results)
        if has_figure:
            yield pooled_row(kind.name, condition, _without_copies(kind.name, condition, used))


def _without_copies(
    figure: str, condition: str, used: Mapping[tuple[str, str], Sequence[Sequence[Figure]]]
) -> list[tuple[str, Sequence[Figure]]]:
    """Return the rows of the results by drive. Of several sources of a drive, that with the largest figure is used."""
    worst: dict[str, tuple[float, Sequence[Sequence[Figure]]]] = {}
    for (drive, _), results in used.items():
        row = pooled_row(figure, condition, [(drive, rows) for rows in results])
        size = row.mean_plus_3sigma
        if size is None:
            size = float(np.linalg.norm([item.mean or 0.0 for item in results[0]]))
        if drive not in worst or size > worst[drive][0]:
            worst[drive] = size, results
    return [(drive, rows) for drive, (_, results) in worst.items() for rows in results]


def axis_row(score: Score, figure: str, condition: str, axis: str | None) -> Figure | None:
    """Return the row of an axis of a figure; without axes, the row of the judged reading."""
    if axis is None:
        return score.judged_row(figure, condition=condition)
    return score.figure(figure, condition=condition, part=axis)


def pooled_row(figure: str, condition: str, used: Sequence[tuple[str, Sequence[Figure]]]) -> Figure:
    """Return mean, sigma and mean + 3 sigma of all values; `used` has the drive and the rows by axis of each result.

    The interval resamples drives, each with all of its results. `independent` is the number of drives.
    """
    numbers = {drive: number for number, drive in enumerate(dict.fromkeys(drive for drive, _ in used))}
    many = len(numbers)
    count = np.array([float(rows[0].n or 0) for _, rows in used])
    total = int(count.sum())
    if not used:
        return figure_row(figure, condition, POOLED, n=0, independent=0)
    means = np.array([[row.mean for row in rows] for _, rows in used], np.float64)
    if total < 2:
        return figure_row(figure, condition, POOLED, n=total, independent=many)
    sigmas = np.array([[row.sigma or 0.0 for row in rows] for _, rows in used], np.float64)
    squares = np.square(sigmas) * (count[:, None] - 1.0)
    mean, sigma = (float(values[0]) for values in _pooled(count, means, squares, np.ones((1, len(count)))))
    found: dict[str, Any] = {"mean": mean, "sigma": sigma, "mean_plus_3sigma": mean_plus_3sigma(mean, sigma)}
    if means.shape[1] == 1:  # the mean of a scalar figure keeps its sign
        found["mean"] = float(count @ means[:, 0]) / total
    if many >= MIN_DRIVES and found["mean_plus_3sigma"] > 0.0:
        weights = drawn_weights(many)[:, [numbers[drive] for drive, _ in used]]
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
