"""Publish a score as a JSON report, as diagnostics, and as single figures on topics of their own."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from std_msgs.msg import Float64, String

from sfr_loc_map.message_types import Level
from sfr_loc_map.metrics.config import VerdictState
from sfr_loc_map.metrics.figures.catalogue import KINDS
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.stored.score_json import to_json
from sfr_loc_map.nodes.lifecycle.endpoints import Endpoints
from sfr_loc_map.ros.messages import header_msg
from sfr_loc_map.ros.statuses import Value, status_msg
from sfr_loc_map.topics import METRICS, REPORT

VERDICT_LEVELS = {
    VerdictState.PASS: Level.OK,
    VerdictState.FAIL: Level.ERROR,
    VerdictState.NOT_ENOUGH_DATA: Level.WARN,
    VerdictState.INCOMPLETE: Level.WARN,
    VerdictState.NOT_JUDGED: Level.WARN,
}
RESTS = 9.0  #: Pause after each score, as a multiple of the processor time of this score.


class ScorePublisher:
    """Publishes scores."""

    def __init__(self, endpoints: Endpoints) -> None:
        """Create the publishers."""
        self._metrics = endpoints.add_publisher(DiagnosticArray, METRICS, 10)
        self._report = endpoints.add_publisher(String, REPORT, 1, latched=True)
        self._figures = {topic: endpoints.add_publisher(Float64, topic, 10) for topic in figure_topics()}

    def publish(self, score: Score, stamp_ns: int) -> None:
        """Publish a score with the stamp of the last message that contributes to it."""
        self._report.publish(String(data=to_json(score)))
        for topic, (figure, statistic) in figure_topics().items():
            value = score.number(figure, statistic)
            if value is not None:
                self._figures[topic].publish(Float64(data=float(value)))
        self._metrics.publish(DiagnosticArray(header=header_msg(stamp_ns, ""), status=score_statuses(score)))


class ScorePacing:
    """Limits scoring to a tenth of the processor time of its thread."""

    def __init__(self) -> None:
        """Make the first score due immediately."""
        self._rest_until_s = 0.0

    def is_due(self) -> bool:
        """Return whether the pause after the last score is over."""
        return time.perf_counter() >= self._rest_until_s

    @contextmanager
    def measured(self) -> Iterator[None]:
        """Pause after the `with` block in proportion to its processor time, which excludes other load of the host."""
        begin_s = time.thread_time()
        yield
        self._rest_until_s = time.perf_counter() + RESTS * (time.thread_time() - begin_s)


def figure_topics() -> dict[str, tuple[str, str]]:
    """Return figure and statistic by topic (`metrics/position/mean`)."""
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
