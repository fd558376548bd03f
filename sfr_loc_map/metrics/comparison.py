"""Which of several estimates is better, by how much, and is that more than chance?

Sub-trajectories of the same condition with the same first and last stamp are paired, so that what makes a stretch hard
for both does not blur the difference. For the interval on the difference both series are resampled in the very same
blocks (circular block bootstrap, as for the interval of one figure, see `metrics.confidence`), which keeps the pairing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.metrics.condition_score import FIGURES
from sfr_loc_map.metrics.confidence import MIN_FREEDOM, MIN_INDEPENDENT, WIDENING, blocks_share, resampled_figures
from sfr_loc_map.metrics.quantiles import student_quantile
from sfr_loc_map.metrics.statistics import norm

SCHEMA = "sfr-compare/1"
ERRORS = ("x_m", "y_m", "z_m", "attitude_deg", "heading_deg")
SIDE_BY_SIDE = (
    ("map", "point_error_m", "mean"),
    ("map", "point_error_m", "mean_plus_3sigma"),
    ("map", "coverage"),
    ("timing", "localisation_s", "p50"),
    ("timing", "localisation_s", "p95"),
    ("timing", "mapping_s", "p50"),
    ("timing", "mapping_s", "p95"),
    ("memory", "localisation_peak_bytes"),
    ("memory", "mapping_peak_bytes"),
)
"""Figures of the whole run, which cannot be paired."""
_PRECISION = 1e-9
"""The errors in a score's details are rounded to this."""


def compare_scores(scores: Sequence[Mapping[str, Any]], names: Sequence[str]) -> dict[str, Any]:
    """Return the comparison of scores with the first of them.

    Args:
        scores: Scores as in the JSON, at least two.
        names: Name of each.

    Returns:
        `{"schema", "names", "pairs": [...], "side_by_side": [...]}`. A pair tells, for one condition, one figure and
        one other score: number of common sub-trajectories, mean + 3 sigma of both over these, the difference (other
        less first, so that below zero the other is better), its 95 % interval, and `better`, `worse`, `equal` or `no
        difference shown` (the interval holds zero) or `not enough data`.

    Raises:
        MetricsError: If there are fewer than two scores, or nothing that two of them have in common.
    """
    if len(scores) < 2:
        raise MetricsError(f"a comparison needs two scores or more, found {len(scores)}: give several score files")
    pairs = [pair for number in range(1, len(scores)) for pair in _compared(scores[0], scores[number], names[number])]
    side_by_side = [row for place in SIDE_BY_SIDE if (row := _row(scores, place)) is not None]
    if not pairs and not side_by_side:
        raise MetricsError("the scores have no condition and no figure in common: score the same data alike")
    return {"schema": SCHEMA, "names": list(names), "pairs": pairs, "side_by_side": side_by_side}


def _compared(first: Mapping[str, Any], other: Mapping[str, Any], name: str) -> list[dict[str, Any]]:
    rebase = [score.get("trajectory", {}).get("rebase") for score in (first, other)]
    if rebase[0] != rebase[1]:
        raise MetricsError(
            f"the first score is re-based by {rebase[0]}, '{name}' by {rebase[1]}: unlike figures are not compared; "
            "score both alike"
        )
    results = []
    theirs = {_key(part): part for part in _sub_trajectories(other)}
    for part in _sub_trajectories(first):
        if _key(part) in theirs:
            results += _condition_pairs(part, theirs[_key(part)], name)
    return results


def _sub_trajectories(score: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    details = score.get("details", {}).get("trajectory", {})
    parts: list[Mapping[str, Any]] = details.get("sub_trajectories", [])
    return parts


def _key(part: Mapping[str, Any]) -> tuple[Any, ...]:
    return tuple(part["condition"].items())


def _condition_pairs(part: Mapping[str, Any], other: Mapping[str, Any], name: str) -> list[dict[str, Any]]:
    spans = [list(zip(p["start_stamp_ns"], p["end_stamp_ns"], strict=True)) for p in (part, other)]
    rows = {span: row for row, span in enumerate(spans[1])}
    common = [(row, rows[span]) for row, span in enumerate(spans[0]) if span in rows]
    if not common:
        return []
    mine, theirs = (list(side) for side in zip(*common, strict=True))
    a, b = _errors(part, mine), _errors(other, theirs)
    overlap = _overlap(part, mine)
    return [
        {
            "name": name,
            "condition": part["condition"],
            "figure": figure,
            "count": len(common),
            "left_out": [len(spans[0]) - len(common), len(spans[1]) - len(common)],
            **_difference(a[:, columns], b[:, columns], overlap),
        }
        for figure, columns in FIGURES.items()
    ]


def _errors(part: Mapping[str, Any], rows: Sequence[int]) -> FloatArray:
    return np.column_stack([np.asarray(part[name], np.float64)[list(rows)] for name in ERRORS])


def _overlap(part: Mapping[str, Any], rows: Sequence[int]) -> float:
    """Return the mean number of starts within one sub-trajectory."""
    starts = np.asarray(part["start_frame"])[list(rows)]
    ends = np.asarray(part["end_frame"])[list(rows)]
    inside = np.searchsorted(starts, ends, side="left") - np.arange(len(starts))
    return float(np.maximum(inside, 1).mean())


def _difference(a: FloatArray, b: FloatArray, overlap: float) -> dict[str, Any]:
    values = [_mean_plus_3sigma(errors) for errors in (a, b)]
    result: dict[str, Any] = {"first": values[0], "other": values[1], "difference": None, "ci95": None}
    if values[0] is None or values[1] is None:
        return result | {"verdict": "not enough data"}
    difference = values[1] - values[0]
    result["difference"] = difference
    independent = len(a) / overlap
    if np.array_equal(a, b):
        return result | {"ci95": [0.0, 0.0], "verdict": "equal"}
    if independent < MIN_INDEPENDENT:
        return result | {"verdict": "not enough data"}
    block = max(1, int(np.ceil(overlap)))
    scatter = np.std(resampled_figures(b, block) - resampled_figures(a, block))
    share = (1.0 - 1.0 / independent) * blocks_share(overlap, float(block))
    factor = WIDENING * student_quantile(0.975, max(independent - 1.0, MIN_FREEDOM))
    half = float(factor * scatter / np.sqrt(share)) + _PRECISION
    word = "no difference shown" if abs(difference) <= half else "better" if difference < 0 else "worse"
    return result | {"ci95": [difference - half, difference + half], "verdict": word}


def _mean_plus_3sigma(errors: FloatArray) -> float | None:
    if len(errors) < 2:
        return None
    return norm(errors.mean(axis=0)) + 3.0 * norm(errors.std(axis=0, ddof=1))


def _row(scores: Sequence[Mapping[str, Any]], place: tuple[str, ...]) -> dict[str, Any] | None:
    values = []
    for score in scores:
        value: Any = score
        for key in place:
            value = value.get(key) if isinstance(value, Mapping) else None
        values.append(value)
    return {"figure": ".".join(place), "values": values} if sum(value is not None for value in values) > 1 else None
