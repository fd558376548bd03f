"""The score as JSON values, for callers that do not use its fields."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from sfr_loc_map.metrics.json_records import to_plain
from sfr_loc_map.metrics.score_json import SCHEMA as SCHEMA

without_nan = to_plain


def to_json(score: Mapping[str, Any]) -> str:
    """Return the score as text."""
    return json.dumps(score, allow_nan=False, separators=(",", ":")) + "\n"


def failed(score: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the verdicts that are `fail`."""
    return [item for item in score["verdicts"] if item["verdict"] == "fail"]
