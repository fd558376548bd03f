"""Reports of a node on /diagnostics, for people and rqt: health, each call, and unusable input.

Programs read the calls on `<node>/call` (`calls.call_record`).

Levels. OK: the node works normally. WARN: the node works, but data are lost, late or suspect. ERROR: the node cannot do
its work (tracking lost, unusable input, a failed transition). STALE: the node is active but has not received input for
`stale_after_s`, so its figures are outdated.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from threading import Lock
from types import MappingProxyType

import numpy as np
import psutil
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.qos import QoSProfile

from sfr_loc_map.calls.call_record import CallRecord
from sfr_loc_map.configuration.parameters import param
from sfr_loc_map.message_text import kind_of, one_line
from sfr_loc_map.message_types import HealthKey, Level, StatusKind
from sfr_loc_map.ros.messages import header_msg
from sfr_loc_map.ros.statuses import Value, status_msg
from sfr_loc_map.topics import DIAGNOSTICS

QUEUE_DEPTH = 1000  #: Number of statuses kept for a slow subscriber.
LOG_PERIOD_S = 5.0  #: Minimum interval between log lines of one kind.
LATENCY_WINDOW = 200  #: Number of calls over which the 95th percentile of a latency is computed.
MAX_MOMENTS = 10_000  #: Maximum number of arrivals or calls kept for a rate.
MAX_KINDS = 10  #: Maximum number of kinds of messages that are logged in `LOG_PERIOD_S`, because texts may be hostile.
MAX_REASONS = 4  #: Maximum number of reasons in a message.
MB = 1_000_000
DROPS = {
    "dropped_overload": "arrived faster than they are processed: reduce the rate, or use a faster host",
    "dropped_in_transport": "were lost between their publisher and this node",
    "dropped_unpaired": "had no message of the other side within the stamp tolerance, or within the queue",
    "dropped_rejected": "were unusable",
    "dropped_stale": "did not have a later stamp than the previous message",
    "dropped_stray": "had no stamp, a stamp far from those of their neighbours, or a repeated stamp",
    "dropped_without_camera_info": "arrived without a usable camera_info",
    "dropped_without_pose": "had no nav/pose with their stamp",
}
"""Texts that are logged and reported for counts that grow; they follow the word "messages"."""
OFFSETS = {
    "vertical_offset_px": (0.3, "vertical disparity above {:g} px"),
    "roll_offset_px": (0.5, "vertical disparity that changes by more than {:g} px over one focal length"),
    "disparity_offset_px": (0.3, "disparity bias above {:g} px"),
}
"""Monitored statistics of the localiser, each with its limit and warning; they indicate a pitch, roll or yaw error of
the right camera, which the localiser corrects. A limit of 0.3 px is the standard deviation of the disparity bias before
the first correction (docs/localisation.md); the limit of the roll was chosen."""


class NodeState(StrEnum):
    """Primary states of a managed node (design.ros2.org, "Managed nodes")."""

    UNCONFIGURED = "unconfigured"
    INACTIVE = "inactive"
    ACTIVE = "active"
    FINALIZED = "finalized"


SEVERITY = (Level.OK, Level.WARN, Level.STALE, Level.ERROR)
"""Levels in the order of increasing severity: stale is worse than a warning, and an error is worse than stale."""


@dataclass(frozen=True, slots=True)
class HealthConfig:
    """Thresholds of a node's warnings, and the period of its health status."""

    period_s: float = param(
        1.0, unit="s", doc="Period of the health status, which is also published when it changes.", low=0.1, high=60.0
    )
    window_s: float = param(
        5.0,
        unit="s",
        doc="Averaging window for rates, and time for which drops and problems are reported.",
        low=0.5,
        high=600.0,
    )
    stale_after_s: float = param(
        5.0, unit="s", doc="Time without input after which an active node is stale.", low=0.1, high=3600.0
    )
    memory_warn_mb: int = param(
        4000, unit="MB", doc="Resident memory of the process above which a warning is issued.", low=1, high=10_000_000
    )


@dataclass(frozen=True, slots=True)
class NodeSnapshot:
    """The present state of a node: lifecycle, dropped and waiting messages, and problems of its environment."""

    lifecycle: str
    counts: Mapping[str, int]
    waiting: int
    expects_input: bool
    reasons: Sequence[tuple[Level, str]] = ()


class StatusReporter:
    """Reports health, calls and problems of one node. All methods may be called in any thread."""

    def __init__(self, node: Node, task: str, config: HealthConfig, snapshot: Callable[[], NodeSnapshot]) -> None:
        """Create the publisher; `snapshot` returns the present state of the node."""
        self._config = config
        self._node, self._task, self._snapshot = node, task, snapshot
        self._last_health: tuple[str, ...] = ()  # lifecycle state, level and lasting reasons last published
        self._lock, self._process = Lock(), psutil.Process()
        self._activity = ""
        self.publisher = node.create_publisher(DiagnosticArray, DIAGNOSTICS, QoSProfile(depth=QUEUE_DEPTH))
        self.reset()

    def reset(self) -> None:
        """Forget arrivals, calls and problems, because the node has become active or inactive."""
        with self._lock:
            self._since = self._last_arrival = time.monotonic()
            self._arrivals: deque[float] = deque(maxlen=MAX_MOMENTS)
            self._calls: deque[float] = deque(maxlen=MAX_MOMENTS)
            self._latencies: dict[str, deque[float]] = {}
            self._problems: dict[str, tuple[float, Level, str]] = {}
            self._logged: dict[str, float] = {}
            self._counts: dict[str, int] = {}
            self._drops: dict[str, float] = {}
            self._last_call: tuple[Level, str] | None = None
            self._offsets: dict[str, float] = {}
            self._call_count = 0

    @property
    def call_count(self) -> int:
        """Number of calls that `report_call` has reported since the reset."""
        return self._call_count

    def set_config(self, config: HealthConfig) -> None:
        """Use other thresholds."""
        self._config = config

    def set_activity(self, activity: str) -> None:
        """Set what the node does besides its calls: `COMPILING`, or empty for nothing."""
        self._activity = activity

    def note_arrival(self) -> None:
        """Record that input was received."""
        with self._lock:
            self._last_arrival = time.monotonic()
            self._remember(self._arrivals, self._last_arrival)

    def note_call(
        self,
        level: Level,
        state: str,
        times: Mapping[str, float] = MappingProxyType({}),
        statistics: Mapping[str, float] = MappingProxyType({}),
    ) -> None:
        """Record a call.

        Its latencies are summarised, and those of its statistics that are in `OFFSETS` are monitored.
        """
        with self._lock:
            self._remember(self._calls, time.monotonic())
            self._last_call = (level, state)
            self._offsets |= {name: float(statistics[name]) for name in OFFSETS if name in statistics}
            for name, seconds in times.items():
                if name.startswith("latency_"):
                    self._latencies.setdefault(name, deque(maxlen=LATENCY_WINDOW)).append(seconds)

    def note_problem(self, level: Level, text: str, kind: str = "") -> None:
        """Record a problem, which stays visible for `window_s` and replaces an earlier problem of the same kind.

        Without a `kind`, problems whose texts differ only in their numbers are of one kind.
        """
        kind = kind or kind_of(text)
        with self._lock:
            self._problems.pop(kind, None)  # the newest problem is last
            self._problems[kind] = (time.monotonic(), level, text)

    def publish_health(self, *, only_changes: bool = False) -> None:
        """Publish the health, worst reason first; with `only_changes` only if state, level or reasons have changed."""
        snapshot = self._snapshot()
        with self._lock:
            now = time.monotonic()
            memory = int(self._process.memory_info().rss)
            self._note_drops(snapshot.counts, now)
            lasting = self._lasting_reasons(now, memory, snapshot)
            reasons = self._recent_problems(now) + lasting
            level = max((found for found, _ in reasons), key=SEVERITY.index, default=Level.OK)
            state = snapshot.lifecycle if self._last_call is None else self._last_call[1]
            message = _joined(reasons) or state
            values = self._health_values(now, memory, snapshot)
            health = (snapshot.lifecycle, level.name, *(text for _, text in lasting))
            has_changed = health != self._last_health
            self._last_health = health
        if has_changed or not only_changes:
            self._publish(StatusKind.HEALTH, level, message, values)

    def _note_drops(self, counts: Mapping[str, int], now: float) -> None:
        """Record the time of each count that has grown."""
        for name, count in counts.items():
            if count > self._counts.get(name, 0):
                self._drops[name] = now
            self._counts[name] = count

    def _recent_problems(self, now: float) -> list[tuple[Level, str]]:
        """Forget the problems from before the window, and return the others, newest first."""
        window_s = self._config.window_s
        self._problems = {key: item for key, item in self._problems.items() if now - item[0] <= window_s}
        return [(level, text) for _, level, text in reversed(self._problems.values())]

    def _health_values(self, now: float, memory: int, snapshot: NodeSnapshot) -> dict[str, Value]:
        values: dict[str, Value] = {
            HealthKey.LIFECYCLE: snapshot.lifecycle,
            HealthKey.ACTIVITY: self._activity,
            HealthKey.PERIOD: self._config.period_s,
            "received_messages_hz": self._rate(self._arrivals, now),
            "processed_hz": self._rate(self._calls, now),
            "waiting": snapshot.waiting,
            "resident_memory_bytes": memory,
        }
        values |= self._offsets
        for name, seconds in self._latencies.items():
            values[name.removesuffix("_s") + "_p95_s"] = float(np.quantile(seconds, 0.95))
        return values | dict(snapshot.counts)

    def _lasting_reasons(self, now: float, memory: int, snapshot: NodeSnapshot) -> list[tuple[Level, str]]:
        """Return the reasons that hold now, in contrast to problems, which were noted at a time."""
        config, found = self._config, list(snapshot.reasons)
        if memory > config.memory_warn_mb * MB:
            found.append((Level.WARN, f"more than {config.memory_warn_mb} MB of resident memory in use"))
        if snapshot.lifecycle != NodeState.ACTIVE:
            return found
        if snapshot.expects_input and now - self._last_arrival > config.stale_after_s:
            found.append((Level.STALE, f"no input for more than {config.stale_after_s:g} s"))
        if self._last_call is not None and self._last_call[0] is not Level.OK:
            found.append(self._last_call)
        recent = [name for name, at in self._drops.items() if now - at <= config.window_s]
        found += [(Level.WARN, f"messages {DROPS.get(name, 'were dropped')} ({name})") for name in recent]
        for limit, text in (OFFSETS[name] for name, offset in self._offsets.items() if abs(offset) > OFFSETS[name][0]):
            found.append((Level.WARN, text.format(limit) + ": check the calibration"))
        return found

    def _remember(self, moments: deque[float], now: float) -> None:
        """Add a time, and forget the times before the window."""
        moments.append(now)
        while now - moments[0] > self._config.window_s:
            moments.popleft()

    def _rate(self, moments: deque[float], now: float) -> float:
        """Return the rate over the window, Hz, or over the time since the reset if that time is shorter.

        The time since the reset counts as at least 1 s, so that two messages soon after the reset are not a high rate.
        """
        span = min(self._config.window_s, max(now - self._since, 1.0))
        return sum(now - moment <= span for moment in moments) / span

    def report_call(self, call: CallRecord, level: Level, memory_method: str) -> None:
        """Publish state, time and memory of a call, and note the call for the health.

        `memory_method` is how the memory was measured.
        """
        self._call_count += 1
        costs = {
            "processing_time_s": call.processing_time_s,
            "peak_rss_bytes": call.peak_rss_bytes,
            "above_idle_bytes": call.above_idle_bytes,
        }
        values: dict[str, Value] = {"task": self._task, "stamp_ns": call.stamp_ns, "state": call.state}
        values |= {"reason": call.reason, "memory_method": memory_method}
        values |= {name: value for name, value in costs.items() if value is not None}
        values |= {**call.times, **call.counts}
        self._publish(StatusKind.CALL, level, call.outcome, values, call.stamp_ns)
        self.note_call(level, call.outcome, call.times, call.statistics)
        self.publish_health(only_changes=True)

    def error(self, text: str) -> None:
        """Report an input that cannot be used: log, /diagnostics, health."""
        self._report_error(StatusKind.INPUT, text)

    def fault(self, text: str) -> None:
        """Report an internal fault: log, /diagnostics, health."""
        self._report_error(StatusKind.FAULT, text)

    def _report_error(self, kind: StatusKind, text: str) -> None:
        text = one_line(text)
        if self._is_log_due(text):
            self._node.get_logger().error(text)
        self.note_problem(Level.ERROR, text)
        self._publish(kind, Level.ERROR, text, {"task": self._task, **self._snapshot().counts})
        self.publish_health(only_changes=True)

    def info(self, text: str) -> None:
        """Report an observation about the input, in the log only."""
        self._node.get_logger().info(one_line(text))

    def warn(self, text: str, kind: str = "") -> None:
        """Report a problem that does not stop the node: log, and health with the latest problem of each kind."""
        text = one_line(text)
        if self._is_log_due(kind or text):
            self._node.get_logger().warning(text)
        self.note_problem(Level.WARN, text, kind)
        self.publish_health(only_changes=True)

    def _is_log_due(self, text: str) -> bool:
        """Return whether a message may be logged: the first of its kind in `LOG_PERIOD_S`, and of `MAX_KINDS` kinds."""
        kind, now = kind_of(text), time.monotonic()
        with self._lock:
            self._logged = {logged: at for logged, at in self._logged.items() if now - at < LOG_PERIOD_S}
            if kind in self._logged or len(self._logged) >= MAX_KINDS:
                return False
            self._logged[kind] = now
            return True

    def _publish(
        self, kind: StatusKind, level: Level, message: str, values: Mapping[str, Value], stamp_ns: int | None = None
    ) -> None:
        status = status_msg(f"{self._node.get_fully_qualified_name().lstrip('/')}: {kind}", level, message, values)
        stamp_ns = self._node.get_clock().now().nanoseconds if stamp_ns is None else stamp_ns
        self.publisher.publish(DiagnosticArray(header=header_msg(stamp_ns, ""), status=[status]))


def _joined(reasons: Sequence[tuple[Level, str]]) -> str:
    """Return the texts of at most `MAX_REASONS` reasons, the worst first; empty without reasons."""
    texts = [text for severity in reversed(SEVERITY) for level, text in reasons if level is severity]
    if len(texts) > MAX_REASONS:
        texts[MAX_REASONS:] = [f"and {len(texts) - MAX_REASONS} more"]
    return "; ".join(texts)
