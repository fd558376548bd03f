"""The score as JSON: one schema for files, for topics and for the report, which is made from it alone."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

from sfr_loc_map.metrics.limits import FAIL, Limits, verdicts

SCHEMA = "sfr-score/1"
PARTS = ("trajectory", "map", "timing", "memory", "target")


def build_score(
    parts: Mapping[str, Any], *, limits: Limits | None = None, provenance: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Return the score with its verdicts, in the order of the schema; parts that are absent or empty are left out.

    Args:
        parts: `trajectory`, `map`, `timing`, `memory`, `target`, `warnings`, `details`, as far as they are there.
        limits: Limits to judge by.
        provenance: Versions, inputs with hashes, configuration, time.
    """
    score: dict[str, Any] = {"schema": SCHEMA}
    score |= {name: parts[name] for name in PARTS if parts.get(name)}
    score["verdicts"] = verdicts(limits, score) if limits is not None else []
    if parts.get("warnings"):
        score["warnings"] = parts["warnings"]
    if provenance is not None:
        score["provenance"] = dict(provenance)
    if parts.get("details"):
        score["details"] = parts["details"]
    plain: dict[str, Any] = without_nan(score)
    return plain


def without_nan(value: Any) -> Any:  # noqa: ANN401 - any value of JSON
    """Return the same with None for every number that is not finite."""
    if isinstance(value, Mapping):
        return {key: without_nan(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [without_nan(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def to_json(score: Mapping[str, Any]) -> str:
    """Return the score as text; numbers in the shortest form that reads back to the same bits."""
    return json.dumps(score, allow_nan=False, separators=(",", ":")) + "\n"


def failed(score: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the verdicts that are `fail`."""
    return [item for item in score["verdicts"] if item["verdict"] == FAIL]
