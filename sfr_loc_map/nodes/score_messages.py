"""Convert a score to messages: diagnostics, and a topic for each figure."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticStatus

from sfr_loc_map.message_types import Level
from sfr_loc_map.metrics.config import VerdictState
from sfr_loc_map.metrics.figures.catalogue import KINDS
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.ros.statuses import Value, status_msg

VERDICT_LEVELS = {
    VerdictState.PASS: Level.OK,
    VerdictState.FAIL: Level.ERROR,
    VerdictState.NOT_ENOUGH_DATA: Level.WARN,
    VerdictState.INCOMPLETE: Level.WARN,
    VerdictState.NOT_JUDGED: Level.WARN,
}


def figure_topics() -> dict[str, tuple[str, str]]:
    """Return figure and statistic by topic (`metrics/position/mean`); config/sros2_policy.xml lists these topics."""
    return {
        f"metrics/{kind.topic}/{statistic}": (kind.name, statistic)
        for kind in KINDS.values()
        if kind.topic
        for statistic in kind.shown
    }


def score_statuses(score: Score) -> list[DiagnosticStatus]:
    """Return a score as diagnostics: one status for each row of the table of figures and for each verdict."""
    found = []
    for row in score.figures:
        names = (row.subject, row.condition, row.part, row.figure)
        numbers = {name: value for name, value in row.as_dict().items() if isinstance(value, int | float)}
        level, text = Level.OK, "" if row.is_defined else "unknown"
        if not row.is_defined and not row.is_one_number:
            level, text = Level.WARN, VerdictState.NOT_ENOUGH_DATA.value
        found.append(status_msg("/".join(filter(None, names)), level, text, {**numbers, "unit": row.unit}))
    for item in score.verdicts:
        values: dict[str, Value] = {"limit": item.limit}
        values |= {} if item.value is None else {"value": item.value}
        values |= {} if item.margin is None else {"margin": item.margin}
        name = "/".join(filter(None, ("verdict", item.name, item.condition)))
        found.append(status_msg(name, VERDICT_LEVELS[item.state], item.state.value, values))
    return found
