"""A score as diagnostics."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus

from sfr_loc_map.metrics.config import VerdictState
from sfr_loc_map.nodes.diagnostics.key_values import Level, Value, status_msg

PARTS = ("trajectory", "map", "timing", "memory")
VERDICT_LEVELS = {VerdictState.PASS: Level.OK, VerdictState.FAIL: Level.ERROR, VerdictState.NOT_ENOUGH_DATA: Level.WARN}


def score_statuses(score: Mapping[str, Any]) -> list[DiagnosticStatus]:
    """Return a score (JSON) as diagnostics: a status for each group of figures, one for each verdict as its level."""
    statuses = [status for part in PARTS for status in _part_statuses(part, score.get(part, {}))]
    return statuses + [_verdict_status(item) for item in score.get("verdicts", [])]


def _part_statuses(part: str, content: Mapping[str, Any]) -> Iterator[DiagnosticStatus]:
    if plain := _plain(content):
        yield status_msg(part, Level.OK, "", plain)
    for name, figure in content.items():
        if isinstance(figure, dict) and "mean" in figure:
            values = _plain(figure)
            level = Level.OK if values.get("mean_plus_3sigma") is not None else Level.WARN
            yield status_msg(f"{part}/{name}", level, "" if values else "not enough data", values)


def _verdict_status(item: Mapping[str, Any]) -> DiagnosticStatus:
    level = VERDICT_LEVELS[VerdictState(item["verdict"])]
    return status_msg(f"verdict/{item['metric']}", level, item["verdict"], _plain(item))


def _plain(content: Mapping[str, Any]) -> dict[str, Value]:
    """Return what is a number or a word."""
    return {name: value for name, value in content.items() if isinstance(value, (int, float, str))}
