"""Publish a score as a report, as diagnostics, and with each figure on its own topic."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from diagnostic_msgs.msg import DiagnosticArray
from std_msgs.msg import Float64, String

from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.stored.score_json import to_json
from sfr_loc_map.nodes.lifecycle.endpoints import Endpoints
from sfr_loc_map.nodes.score_messages import figure_topics, score_statuses
from sfr_loc_map.ros.messages import header_msg
from sfr_loc_map.topics import METRICS, REPORT

RESTS = 9.0  #: Time without scoring after each score, as a multiple of the processor time of that score.


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
