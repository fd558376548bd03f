"""The figure by which recordings are compared, from the report of a replay."""

from __future__ import annotations

from pathlib import Path

from sfr_loc_map.metrics.stored.score_json import load_score

_OVER_1_M = "minimum_count: 2\nminimum_independent: 2\ntrajectory:\n  - {condition: distance=1, %s: %g}\n"
LIMITS = {
    "position": _OVER_1_M % ("position_mean_plus_3sigma_m", 0.05),
    # fixes have errors of some centimetres, so the limit is larger
    "chord": _OVER_1_M % ("chord_mean_plus_3sigma_m", 0.2),
    "map": "map: {point_error_p95_m: 1.0}\n",
}


def error_of(figure: str, out: Path) -> float | None:
    """Return mean + 3 sigma of the error over 1 m, mm, or the 95th percentile of a map, m; None if unknown."""
    score = load_score(out / "report.json")
    if figure == "map":
        return score.number("point_error", "p95", part=None)
    found = score.number(figure, "mean_plus_3sigma", condition="distance=1")
    return None if found is None else 1e3 * found
