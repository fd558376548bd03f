"""Events of a run as time intervals: localisation states, node states, jumps of the stamps, missed limits."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

from sfr_loc_map.calls.call_record import CallRecord
from sfr_loc_map.live import updates
from sfr_loc_map.live.freshness import ReceivedTopic, smoothed
from sfr_loc_map.live.limit_bars import LimitBar
from sfr_loc_map.live.node_reports import LOCALISATION_NODE, state_of_pose
from sfr_loc_map.localisation.estimate import TrackingState
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.message_types import COMPILING, HealthKey, Level, StatusKind
from sfr_loc_map.metrics.config import VerdictState

MAX_EVENTS = 400  #: Maximum number of events.
MAX_TEXT = 200  #: Maximum length of a text.
RECENT = 8  #: Number of last events among which the previous event of a lane is searched.
FLICKER_S = 0.5  #: Two intervals of one kind are joined if tracking between them lasted less than this time, s.
GAP_S = 2.0  #: Seconds. A step of the stamps is an event if it exceeds both this and `GAP_PERIODS` times the mean step.
GAP_PERIODS = 20.0
POSE = "pose"  #: Lane of the events of the last pose.


class EventKind(StrEnum):
    """Subject of an event."""

    TRACKING = "tracking"
    DEGRADED = "degraded"
    LOST = "lost"
    STALE = "stale"
    NODE = "node"  #: A node reports an error.
    SILENT = "silent"  #: A node does not report.
    COMPILING = "compiling"
    CLOCK = "clock"
    LIMIT = "limit"
    ABORTED = "aborted"


EVENT_OF_STATE: dict[str, EventKind] = {TrackingState.DEGRADED: EventKind.DEGRADED, TrackingState.LOST: EventKind.LOST}
"""Kind of the event of the last pose, by the state of the pose; `TRACKING` for all other states."""


@dataclass(slots=True)
class Event:
    """A time interval, s. `to_s` is None while the event is in progress, and equal to `from_s` for an instant."""

    lane: str
    from_s: float
    to_s: float | None
    kind: EventKind
    text: str


class Timeline:
    """Collects events, with times of the caller's clock, s. Its memory is bounded."""

    def __init__(self) -> None:
        self.version = 0  # changes with every event that begins or ends
        self.events: list[Event] = []
        self._open: dict[str, Event] = {}
        self._call: CallRecord | None = None  # last call of the localiser
        self._pose: ReceivedTopic | None = None
        self._is_pose_lost = False  # whether the covariance of the last pose reports a loss
        self._step_s = 0.0  # smoothed step of the stamps of poses

    def take_call(self, call: updates.NodeCall) -> None:
        """Process a call: its node is no longer silent, and the state of the last pose may change."""
        node = self._open.get(call.node)
        if node is not None and node.kind is EventKind.SILENT:
            self.note(call.node, call.received_s, None)
        if call.node != LOCALISATION_NODE:
            return
        self._call = call.record
        pose = self._open.get(POSE)
        if pose is not None and pose.kind is not EventKind.STALE:
            self._note_state_of_pose(call.received_s)

    def take_status(self, status: updates.Status) -> None:
        """Process a node's health."""
        if status.kind is not StatusKind.HEALTH:
            return
        # lost poses have their own events
        is_bad = status.level is Level.ERROR and status.node != LOCALISATION_NODE
        kind = EventKind.NODE if is_bad else None
        if status.values.get(HealthKey.ACTIVITY) == COMPILING:
            kind = EventKind.COMPILING
        self.note(status.node, status.received_s, kind, f"{status.node}: {status.message}")

    def take_estimate(self, pose: updates.PoseSample) -> None:
        """Process a pose of the estimate."""
        at_s = pose.received_s
        self.tick(at_s, {})
        if self._pose is not None and self._pose.stamp_ns is not None:
            step_s = (pose.stamp_ns - self._pose.stamp_ns) / NS_PER_S
            if step_s > max(GAP_S, GAP_PERIODS * self._step_s) and self._step_s > 0.0:
                self.mark(at_s, EventKind.CLOCK, f"stamps jump forward by {step_s:.1f} s")
            else:
                self._step_s = smoothed(self._step_s, step_s)
        self._pose = ReceivedTopic.after(self._pose, pose.stamp_ns, at_s)
        self._is_pose_lost = pose.is_lost
        self._note_state_of_pose(at_s)

    def begin_run(self, stamp_ns: int, at_s: float) -> None:
        """Add the jump of the stamps at the start of a new run."""
        if self._pose is None or self._pose.stamp_ns is None:
            return
        back_s = (self._pose.stamp_ns - stamp_ns) / NS_PER_S
        self.mark(at_s, EventKind.CLOCK, f"stamps jump back by {back_s:.1f} s")
        self._pose = replace(self._pose, stamp_ns=None)

    def tick(self, now_s: float, silent: Mapping[str, float]) -> None:
        """Add events for missing poses and for silent nodes, given with the time of their last report."""
        if self._pose is not None and self._pose.is_stale(now_s):
            self.note(POSE, self._pose.received_s, EventKind.STALE, "no pose")
        for node, since_s in silent.items():
            self.note(node, since_s, EventKind.SILENT, f"{node}: silent")

    def judge(self, bars: Iterable[LimitBar], at_s: float) -> None:
        """Start or end the event of each missed limit.

        Each limit has its own lane, even if several apply to one figure.
        """
        for bar in bars:
            missed = EventKind.LIMIT if bar.state == VerdictState.FAIL else None
            self.note(f"limit {bar.place}", at_s, missed, bar.text)

    def note(self, lane: str, at_s: float, kind: EventKind | None, text: str = "") -> None:
        """Start the event of a lane, update its text, or end it if `kind` is None."""
        now = self._open.get(lane)
        if now is not None and now.kind is kind:
            now.text = text[:MAX_TEXT]
            return
        if now is None and kind is None:
            return
        self.version += 1
        if now is not None:
            now.to_s = max(at_s, now.from_s)
            del self._open[lane]
        if kind is None:
            return
        if now is not None and (before := self._before_flicker(now, kind, at_s)) is not None:
            self.events.remove(now)
            before.to_s = None
            self._open[lane] = before
            return
        self._open[lane] = self._add(Event(lane, at_s, None, kind, text[:MAX_TEXT]))

    def _before_flicker(self, ended: Event, kind: EventKind, at_s: float) -> Event | None:
        """Return the event of the given kind that a short tracking event has interrupted; None if there is none."""
        if ended.kind is not EventKind.TRACKING or at_s - ended.from_s >= FLICKER_S:
            return None
        recent = [event for event in self.events[-RECENT:] if event.lane == ended.lane]
        if len(recent) < 2 or recent[-1] is not ended or recent[-2].kind is not kind:
            return None
        return recent[-2]

    def mark(self, at_s: float, kind: EventKind, text: str) -> None:
        """Add an instantaneous event."""
        self.version += 1
        self._add(Event(kind, at_s, at_s, kind, text[:MAX_TEXT]))

    def end_all(self, at_s: float) -> None:
        """End all events in progress."""
        for lane in list(self._open):
            self.note(lane, at_s, None)

    def to_plain(self) -> list[dict[str, Any]]:
        """Return the events as JSON values, in the order of their beginning."""
        ordered = sorted(self.events, key=lambda event: event.from_s)
        return [{"from": e.from_s, "to": e.to_s, "kind": e.kind.value, "text": e.text} for e in ordered]

    def _add(self, event: Event) -> Event:
        self.events.append(event)
        if len(self.events) > MAX_EVENTS:
            ended = next((event for event in self.events if event.to_s is not None), self.events[0])
            self.events.remove(ended)
            self._open = {lane: other for lane, other in self._open.items() if other is not ended}
        return event

    def _note_state_of_pose(self, at_s: float) -> None:
        """Start or continue the event of the last pose."""
        found = state_of_pose(self._call, covariance_is_lost=self._is_pose_lost)
        kind = EVENT_OF_STATE.get(found.state, EventKind.TRACKING)
        text = (found.state or "state unknown") if kind is EventKind.TRACKING else found.text
        self.note(POSE, at_s, kind, text)
