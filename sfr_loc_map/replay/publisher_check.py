"""The publishers of an external node's answers: whether their process is measured, and whether they change."""

from __future__ import annotations

import time

from sfr_loc_map.replay.process_watch import ProcessWatch
from sfr_loc_map.replay.replay_peer import ReplayPeer

CHECK_PERIOD_S = 0.2  #: Period of the checks whether the publishers have changed.


class PublisherCheck:
    """Compares the publishers of a topic with the measured processes, and with the publishers of the first answer."""

    def __init__(self, peer: ReplayPeer, topic: str, watch: ProcessWatch | None) -> None:
        """Check the present publishers; `watch` is None if no process is measured."""
        self._peer = peer
        self._topic = topic
        self._watch = watch
        self._first_ids: set[tuple[int, ...]] | None = None  # of the publishers at the first answer
        self._checked_s = 0.0
        self.is_measured = self._are_measured(self._ids())
        """Whether the publishers belong to the measured processes; true if no process is measured."""

    def note_answer(self) -> None:
        """Note the publishers at the first answer, because a node may create its publisher with its first result."""
        if self._first_ids is None:
            self._first_ids = self._ids()
            self.is_measured = self._are_measured(self._first_ids)

    def have_changed(self) -> bool:
        """Return whether the publishers differ from those at the first answer; checked once per `CHECK_PERIOD_S`.

        A restarted process has another publisher, with another global id. Discovery can take many seconds to report
        that the publisher of a killed process has disappeared, so that an additional publisher counts, too.
        """
        now_s = time.monotonic()
        if self._first_ids is None or now_s - self._checked_s < CHECK_PERIOD_S:
            return False
        self._checked_s = now_s
        return self._ids() != self._first_ids

    def _are_measured(self, ids: set[tuple[int, ...]]) -> bool:
        return self._watch is None or self._watch.has_publishers(ids)

    def _ids(self) -> set[tuple[int, ...]]:
        """Return the global ids of the publishers."""
        found = self._peer.ros_node.get_publishers_info_by_topic(self._topic)
        return {tuple(item.endpoint_gid) for item in found}
