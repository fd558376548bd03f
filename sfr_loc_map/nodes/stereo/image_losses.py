"""The images of a stereo rig that are lost in transport."""

from __future__ import annotations

from sfr_loc_map.nodes.lifecycle.diagnostics import StatusReporter
from sfr_loc_map.nodes.lifecycle.endpoints import Endpoints
from sfr_loc_map.ros.environment import EXPORT_LINE
from sfr_loc_map.ros.transport import TransportGaps, begin_counting
from sfr_loc_map.transport_issues import MUCH_LOST, loss_fix

LOSS_WINDOW = 40  #: Number of images after which the fraction lost in transport is checked again.


class ImageLosses:
    """Counts the lost images of a rig by the sequence numbers of each topic."""

    def __init__(self, rig: str, status: StatusReporter, endpoints: Endpoints) -> None:
        """Start without topics; `rig` is the name of the rig in warnings."""
        self._rig = rig
        self._status = status
        self._endpoints = endpoints
        self._gaps: dict[str, TransportGaps] = {}  # gaps in the sequence numbers, by topic
        self._counts_at_last_fraction = 0, 0  # images lost and sent when the lost fraction was last computed

    def begin_counting(self, topic: str) -> TransportGaps:
        """Return the counter of a topic for a new subscription; the counts of the previous subscription continue."""
        return begin_counting(self._gaps, topic)

    @property
    def count(self) -> int:
        """Number of lost images; may be read in any thread."""
        return sum(gaps.lost for gaps in self._gaps.values())

    def update_publishers(self) -> bool:
        """Count no losses on topics that have several publishers now; return whether there is such a topic."""
        several = {topic: len(self._endpoints.publishers(topic)) > 1 for topic in self._gaps}
        for topic, gaps in self._gaps.items():
            gaps.set_several(several[topic])
        return any(several.values())

    def warn_if_many(self) -> None:
        """Warn if more than `MUCH_LOST` of the images since the last check were lost.

        If a topic has several publishers, its losses are unknown, and nothing is reported.
        """
        lost = self.count
        sent = lost + sum(gaps.count for gaps in self._gaps.values())
        lost_before, sent_before = self._counts_at_last_fraction
        if sent - sent_before < LOSS_WINDOW:
            return
        self._counts_at_last_fraction = lost, sent
        fraction = (lost - lost_before) / (sent - sent_before)
        if fraction <= MUCH_LOST:
            return
        if not self.update_publishers():
            text = f"{fraction:.0%} of the images of '{self._rig}' are lost in transport: {loss_fix(EXPORT_LINE)}"
            self._status.warn(text, "transport")
