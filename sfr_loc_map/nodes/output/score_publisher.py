"""The topics of a score: report, metrics and single figures."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticArray
from std_msgs.msg import Float64, String

from sfr_loc_map.metrics.score import SampleStatistic, Score, Statistic
from sfr_loc_map.metrics.score_json import to_dict, to_json
from sfr_loc_map.nodes.diagnostics.key_values import array_msg
from sfr_loc_map.nodes.lifecycle.endpoints import Endpoints
from sfr_loc_map.nodes.messages.fields import header_msg
from sfr_loc_map.nodes.output.score_status import score_statuses

FIGURES = ("position", "attitude", "heading", "point")
"""Topics below `metrics/`."""
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

    def publish(self, score: Score, stamp_ns: int) -> None:
        """Publish a score.

        Args:
            score: The score.
            stamp_ns: Stamp of the last input.
        """
        self._report.publish(String(data=to_json(score)))
        for name, figure in _figures(score).items():
            for statistic in STATISTICS:
                value = getattr(figure, statistic)
                if value is not None:
                    self._figures[name, statistic].publish(Float64(data=float(value)))
        self._metrics.publish(array_msg(header_msg(stamp_ns, ""), *score_statuses(to_dict(score))))


def _figures(score: Score) -> dict[str, Statistic | SampleStatistic]:
    """Return the figures that the score has, by topic."""
    found: dict[str, Statistic | SampleStatistic] = {}
    if score.trajectory is not None:
        first = score.trajectory.first
        found |= {"position": first.position_m, "attitude": first.attitude_deg, "heading": first.heading_deg}
    if score.map is not None and score.map.errors is not None:
        found["point"] = score.map.errors.point_error_m
    return found
