"""The images of a stereo rig that are lost in transport, and their topics that have several publishers."""

from __future__ import annotations

from sfr_loc_map.nodes.lifecycle.diagnostics import StatusReporter
from sfr_loc_map.nodes.lifecycle.endpoints import Endpoints
from sfr_loc_map.ros.environment import EXPORT_LINE
from sfr_loc_map.ros.transport import TransportGaps, begin_counting
from sfr_loc_map.transport_issues import MUCH_LOST, doubled_publishers, loss_fix

LOSS_WINDOW = 40  #: Number of images after which the fraction lost in transport is checked again.


class ImageLosses:
    """Counts the lost images of a rig by the sequence numbers of each topic."""

    def __init__(self, rig: str, status: StatusReporter, endpoints: Endpoints) -> None:
        """Start without topics; `rig` is the name of the rig in warnings."""
        self._rig = rig
        self._status = status
        self._endpoints = endpoints
        self._gaps: dict[str, TransportGaps] = {}  # gaps in the sequence numbers, by topic
        self._doubled: list[str] = []  # a text for each topic that had several publishers at the last update
        self._counts_at_last_fraction = 0, 0  # images lost and sent when the lost fraction was last computed

    def begin_counting(self, topic: str) -> TransportGaps:
        """Return the counter of a topic for a new subscription; the counts of the previous subscription continue."""
        return begin_counting(self._gaps, topic)

    @property
    def count(self) -> int:
        """Number of lost images; may be read in any thread."""
        return sum(gaps.lost for gaps in self._gaps.values())

    def update_publishers(self) -> None:
        """Count no losses on topics that have several publishers now, and count them on all others."""
        self._doubled.clear()
        for topic, gaps in self._gaps.items():
            issue = doubled_publishers(topic, self._endpoints.publishers(topic))
            gaps.set_several(issue is not None)
            if issue is not None:
                self._doubled.append(f"{topic} has {issue.text}")

    def doubled_text(self) -> str:
        """Return which topics had several publishers at the last update; empty if all had at most one."""
        return f"{'; '.join(self._doubled)}: stop all but one" if self._doubled else ""

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
        self.update_publishers()
        if not self._doubled:
            text = f"{fraction:.0%} of the images of '{self._rig}' are lost in transport: {loss_fix(EXPORT_LINE)}"
            self._status.warn(text, "transport")
