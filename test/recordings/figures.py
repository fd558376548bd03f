"""The error of a replay, as its report has it, beside what an independent calculation says of its estimate."""

from __future__ import annotations

import json
from pathlib import Path

from drive import Drive

LIMITS = {
    "position": "minimum_count: 2\ntrajectory:\n  - {condition: distance=1, position_mean_plus_3sigma_m: 0.05}\n",
    "chord": "minimum_count: 2\ntrajectory:\n  - {condition: distance=1, position_mean_plus_3sigma_m: 0.05}\n",
    "map": "map: {point_error_p95_m: 1.0}\n",
}


def error_of(figure: str, out: Path, drive: Drive) -> float | None:
    """Return the error, mm, of a map the 95th percentile in m; None where the report has none."""
    report = json.loads((out / "report.json").read_text())
    if figure == "map":
        return None if report.get("map") is None else report["map"]["point_error_m"]["p95"]
    found = report["trajectory"]["conditions"][0]["position_m"]["mean_plus_3sigma"]
    return None if found is None else 1e3 * found
