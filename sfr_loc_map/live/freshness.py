"""When data of a run are stale: the permitted silence of nodes and topics, and the last message of each topic."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from sfr_loc_map.topics import ESTIMATE, REPORT


@dataclass(frozen=True, slots=True)
class Freshness:
    """Limits of the time without a message; data are stale once both limits are exceeded."""

    after_s: float
    periods: float  #: Multiple of the message period.

    def is_stale(self, silent_s: float, period_s: float) -> bool:
        """Return whether a silence is too long for a message period, which is 0 if unknown."""
        return silent_s > max(self.after_s, self.periods * period_s)


NODE_FRESHNESS = Freshness(after_s=1.5, periods=1.6)
"""Limits for a node. Its health is published by a timer at a known period, so one missing report indicates silence."""
TOPIC_FRESHNESS = Freshness(after_s=1.6, periods=3.0)
"""Limits for a topic. The period of a topic varies with its source, so two messages may be missing."""
SLOWEST_PERIOD_S = 5.0
"""Assumed period of a topic with a single message, s, because a longer period of poses or figures is unusual."""
MAX_TOPICS = 32
STALE_TOPICS = {ESTIMATE: "pose", REPORT: "figures"}  #: Topics whose silence makes the displayed data stale.
NEWEST_WEIGHT = 0.2  #: Weight of the newest interval in a smoothed period, which averages over about five intervals.


def smoothed(period: float, interval: float) -> float:
    """Return a smoothed period after another interval; a period of 0 is unknown."""
    return interval if period <= 0.0 else (1.0 - NEWEST_WEIGHT) * period + NEWEST_WEIGHT * interval


@dataclass(frozen=True, slots=True)
class ReceivedTopic:
    """Reception time and stamp of the last message of a topic, and the smoothed message period (0: unknown)."""

    stamp_ns: int | None
    received_s: float
    period_s: float = 0.0

    @classmethod
    def after(cls, before: ReceivedTopic | None, stamp_ns: int | None, received_s: float) -> ReceivedTopic:
        """Return the topic after a message; `before` is the previous value, None before the first message."""
        if before is None:
            return cls(stamp_ns, received_s)
        passed_s = max(received_s - before.received_s, 0.0)
        return cls(stamp_ns, received_s, smoothed(before.period_s, passed_s))

    def is_stale(self, now_s: float) -> bool:
        """Return whether the topic has been silent for longer than `TOPIC_FRESHNESS` permits."""
        return TOPIC_FRESHNESS.is_stale(now_s - self.received_s, self.period_s or SLOWEST_PERIOD_S)

    def age_s(self, now_s: float) -> float:
        """Return the time since the last message, s, to the millisecond."""
        return round(max(now_s - self.received_s, 0.0), 3)

    def to_plain(self, now_s: float, lost: int) -> dict[str, Any]:
        """Return the topic as JSON values."""
        stamp = None if self.stamp_ns is None else str(self.stamp_ns)
        age_s = self.age_s(now_s)
        # The rate is unknown if all messages arrived at the same time.
        rate_hz = round(1.0 / self.period_s, 2) if self.period_s > 1e-6 else None
        return {"stamp_ns": stamp, "age_s": age_s, "rate_hz": rate_hz, "stale": self.is_stale(now_s), "lost": lost}


@dataclass(slots=True)
class ReceivedTopics:
    """The topics of a run, by name."""

    by_name: dict[str, ReceivedTopic] = field(default_factory=dict)
    lost: Mapping[str, int] = field(default_factory=dict)  #: Messages lost in transport to this process, by topic.

    def add(self, name: str, stamp_ns: int | None, received_s: float) -> None:
        """Add a message; topics beyond `MAX_TOPICS` are ignored."""
        if name in self.by_name or len(self.by_name) < MAX_TOPICS:
            self.by_name[name] = ReceivedTopic.after(self.by_name.get(name), stamp_ns, received_s)

    def silences(self, now_s: float) -> list[str]:
        """Return a text for each stale topic of `STALE_TOPICS`, which states how long the topic has been silent."""
        known = [(text, self.by_name[name]) for name, text in STALE_TOPICS.items() if name in self.by_name]
        return [f"no {text} for {topic.age_s(now_s):.1f} s" for text, topic in known if topic.is_stale(now_s)]

    def to_plain(self, now_s: float) -> dict[str, Any]:
        """Return the topics as JSON values, by name."""
        found = sorted(self.by_name.items())
        return {name: topic.to_plain(now_s, self.lost.get(name, 0)) for name, topic in found}
