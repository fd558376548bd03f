"""The last reports of each node, as the JSON values that all views show."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from itertools import islice
from typing import Any

from sfr_loc_map.calls.call_record import CallRecord, outcome_text
from sfr_loc_map.live import updates
from sfr_loc_map.live.commands import NODE_ACTIONS
from sfr_loc_map.live.freshness import NODE_FRESHNESS
from sfr_loc_map.localisation.estimate import TrackingState
from sfr_loc_map.message_types import DROPPED, HealthKey, Level, StatusKind
from sfr_loc_map.suite_names import Task

MAX_VALUES = 100  #: Maximum number of kept values of a node's health.
MAX_LETTERS = 300  #: Maximum length of a kept text.
LOCALISATION_NODE = Task.LOCALISATION.node


@dataclass(slots=True)
class NodeReports:
    """The last reports of a node: health, call, and unusable input or internal fault."""

    name: str
    level: Level = Level.STALE
    message: str = ""
    values: dict[str, str] = field(default_factory=dict)
    call: CallRecord | None = None
    problem: str | None = None
    heard_s: float = 0.0
    in_graph: bool | None = None

    def add_call(self, call: updates.NodeCall) -> None:
        """Add a call."""
        self.heard_s = max(self.heard_s, call.received_s)
        self.call = call.record

    def add_status(self, status: updates.Status) -> None:
        """Add a status."""
        self.heard_s = max(self.heard_s, status.received_s)
        message = status.message[:MAX_LETTERS]
        if status.kind is not StatusKind.HEALTH:
            self.problem = message
        else:
            self.level = Level(status.level)
            self.message = message
            kept = islice(status.values.items(), MAX_VALUES)
            self.values = {name[:MAX_LETTERS]: text[:MAX_LETTERS] for name, text in kept}

    def is_stale(self, now_s: float) -> bool:
        """Return whether the node has been silent for longer than `NODE_FRESHNESS` permits at its reported period."""
        return NODE_FRESHNESS.is_stale(now_s - self.heard_s, self._period_s)

    @property
    def _period_s(self) -> float:
        """Period of the health status; 0 if it is unknown."""
        with suppress(ValueError):
            period_s = float(self.values.get(HealthKey.PERIOD, ""))
            return period_s if math.isfinite(period_s) else 0.0
        return 0.0

    def _drops(self) -> dict[str, int]:
        """Return the number of dropped messages by cause, in words."""
        counts = {name: text for name, text in self.values.items() if name.startswith(DROPPED) and text.isdecimal()}
        return {name.removeprefix(DROPPED).replace("_", " "): int(text) for name, text in counts.items()}

    def to_plain(self, now_s: float) -> dict[str, Any]:
        """Return the node as JSON values."""
        stale = self.is_stale(now_s)
        return {
            "name": self.name,
            "stale": stale,
            "age_s": round(max(now_s - self.heard_s, 0.0), 3) if self.heard_s else None,
            "level": (Level.STALE if stale else self.level).word,
            "message": self.message,
            "lifecycle": self.values.get(HealthKey.LIFECYCLE, "unknown"),
            **asdict(state_after(self.call)),
            "in_graph": self.in_graph,
            "problem": self.problem,
            "values": self.values,
            "drops": self._drops(),
            "actions": list(NODE_ACTIONS.get(self.name, ())),
        }


@dataclass(frozen=True, slots=True)
class ReportedState:
    """State of a localiser or mapper with its reason; both are empty if they are unknown."""

    state: str = ""
    reason: str = ""

    @property
    def text(self) -> str:
        """State with its reason, for display."""
        return outcome_text(self.state, self.reason)


def state_after(call: CallRecord | None) -> ReportedState:
    """Return the state that a call has reported; unknown before the first call."""
    return ReportedState() if call is None else ReportedState(call.state, call.reason[:MAX_LETTERS])


def state_of_pose(call: CallRecord | None, *, covariance_is_lost: bool) -> ReportedState:
    """Return the state of the last pose from the last call of its node and from its covariance.

    A pose is lost if its covariance or its call reports a loss, as in the score. The call may arrive after the pose.
    """
    found = state_after(call)
    if covariance_is_lost and found.state != TrackingState.LOST:
        return ReportedState(TrackingState.LOST.value)
    return found
