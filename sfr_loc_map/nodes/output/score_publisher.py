"""The topics of a score: report, metrics and single figures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from std_msgs.msg import Float64, String

from sfr_loc_map.metrics.results import to_json
from sfr_loc_map.nodes.diagnostics.key_values import array_msg
from sfr_loc_map.nodes.lifecycle.endpoints import Endpoints
from sfr_loc_map.nodes.messages.fields import header_msg
from sfr_loc_map.nodes.output.score_status import score_statuses

FIGURES = {
    "position": ("trajectory", "position_m"),
    "attitude": ("trajectory", "attitude_deg"),
    "heading": ("trajectory", "heading_deg"),
    "point": ("map", "point_error_m"),
}
"""Topics below `metrics/`, and where their figures are in the score."""
STATISTICS = ("mean", "sigma", "mean_plus_3sigma")


class ScorePublisher:
    """Publishes a score."""

    def __init__(self, endpoints: Endpoints) -> None:
        """Create the publishers.

        Args:
            endpoints: Of the node.
        """
        self._metrics = endpoints.add_publisher(DiagnosticArray, "metrics", 10)
        self._report = endpoints.add_publisher(String, "metrics/report", 1, latched=True)
        self._figures = {
            (name, statistic): endpoints.add_publisher(Float64, f"metrics/{name}/{statistic}", 10)
            for name in FIGURES
            for statistic in STATISTICS
        }

    def publish(self, score: Mapping[str, Any], stamp_ns: int) -> None:
        """Publish a score (JSON).

        Args:
            score: The score.
            stamp_ns: Stamp of the last input.
        """
        self._report.publish(String(data=to_json(score)))
        for (name, statistic), publisher in self._figures.items():
            part, figure = FIGURES[name]
            value = score.get(part, {}).get(figure, {}).get(statistic)
            if value is not None:
                publisher.publish(Float64(data=float(value)))
        self._metrics.publish(array_msg(header_msg(stamp_ns, ""), *score_statuses(score)))
