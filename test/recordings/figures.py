"""The figure that recordings are compared by, as the report of a replay has it."""

from __future__ import annotations

import json
from pathlib import Path

_OVER_1_M = "minimum_count: 2\ntrajectory:\n  - {condition: distance=1, %s: 0.05}\n"
LIMITS = {
    "position": _OVER_1_M % "position_mean_plus_3sigma_m",
    "chord": _OVER_1_M % "chord_mean_plus_3sigma_m",
    "map": "map: {point_error_p95_m: 1.0}\n",
}


def error_of(figure: str, out: Path) -> float | None:
    """Return mean + 3 sigma of the error over 1 m, mm, of a map the 95th percentile, m; None where there is none."""
    report = json.loads((out / "report.json").read_text())
    if figure == "map":
        return None if report.get("map") is None else report["map"]["point_error_m"]["p95"]
    drive = report["trajectory"]
    over_1_m = next(each for each in drive.get("conditions", [drive]) if each["condition"] == {"distance_m": 1.0})
    found = (over_1_m.get(f"{figure}_m") or {}).get("mean_plus_3sigma")
    return None if found is None else 1e3 * found
