"""The publishers of an external node's answers: whether their process is measured, and whether the process changes."""

from __future__ import annotations

import time

from sfr_loc_map.replay.external.process_watch import ProcessWatch
from sfr_loc_map.replay.replay_peer import ReplayPeer
from sfr_loc_map.ros.publishers import participants_of

CHECK_PERIOD_S = 0.2  #: Period of the checks whether the publishers have changed.


class PublisherCheck:
    """Compares the publishers of a topic with the measured processes, and with the publishers of the first answer."""

    def __init__(self, peer: ReplayPeer, topic: str, watch: ProcessWatch | None) -> None:
        """Check the present publishers; `watch` is None if no process is measured."""
        self._peer = peer
        self._topic = topic
        self._watch = watch
        self._first: set[tuple[int, ...]] | None = None  # participants at the first answer
        self._checked_s = 0.0
        self.is_measured = self._are_measured(self._participants())
        """Whether the publishers belong to the measured processes; true if no process is measured."""
        self.have_restarted = False
        """Whether a process of the publishers has ended since the first answer, even if another has replaced it."""

    def note_answer(self) -> None:
        """Note the publishers at the first answer, because a node may create its publisher with its first result."""
        if self._first is None:
            self._first = self._participants()
            self.is_measured = self._are_measured(self._first)

    def update(self) -> None:
        """Update `is_measured` and `have_restarted`, at most once per `CHECK_PERIOD_S`.

        Discovery can take many seconds to report that the publisher of a killed process has disappeared. The publisher
        of an additional process therefore counts as a restart, too, unless the processes of the first publishers are
        known to run. `is_measured` then applies to all publishers.
        """
        now_s = time.monotonic()
        if self._first is None or now_s - self._checked_s < CHECK_PERIOD_S:
            return
        self._checked_s = now_s
        now = self._participants()
        if not self._first:  # the publisher was not discovered when its first answer was received
            self._first = now
            self.is_measured = self._are_measured(now)
        elif now > self._first and self._watch is not None and self._watch.runs_publishers(self._first):
            self.is_measured = self.is_measured and self._are_measured(now)
        elif now != self._first:
            self.have_restarted = True

    def _are_measured(self, participants: set[tuple[int, ...]]) -> bool:
        return self._watch is None or self._watch.has_publishers(participants)

    def _participants(self) -> set[tuple[int, ...]]:
        """Return the ids of the participants of the publishers."""
        return participants_of(self._peer.ros_node, self._topic)
