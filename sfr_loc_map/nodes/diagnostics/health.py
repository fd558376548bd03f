"""The health of a node, in the levels of /diagnostics.

OK: it does what it is there for. WARN: it works, but something is lost, late or not as it should be. ERROR: it cannot
do its work (lost, unusable input, a failed transition). STALE: it is active but nothing has come for a while, so that
its figures are old.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from threading import Lock

import numpy as np
import psutil

from sfr_loc_map.config import param
from sfr_loc_map.nodes.diagnostics.key_values import Level, Value

SEVERITY = (Level.OK, Level.WARN, Level.STALE, Level.ERROR)
"""From good to bad: that nothing comes is worse than a warning, a known error is worse still."""
LATENCY_WINDOW = 200
"""Calls over which the percentile of a latency is taken."""
MAX_MOMENTS = 10_000
"""Arrivals or calls within the window that a rate is taken over."""
MAX_REASONS = 4
"""Reasons that a message names."""
MB = 1_000_000
OFFSETS = {
    "vertical_offset_px": "vertical disparity of more than {:g} px: check the calibration",
    "roll_offset_px": "vertical disparity grows by more than {:g} px over the focal length: check the calibration",
    "disparity_offset_px": "disparity bias of more than {:g} px: check the calibration",
}
"""Statistics of the localiser that are monitored, and their warnings; limits are `..._offset_warn_px`."""


@dataclass(frozen=True, slots=True)
class HealthConfig:
    """When a node warns."""

    period_s: float = param(
        1.0, unit="s", doc="Period of the health, which is also published at once when it changes.", low=0.1, high=60.0
    )
    window_s: float = param(
        5.0, unit="s", doc="Rates are taken over it; a drop or a problem shows for so long.", low=0.5, high=600.0
    )
    stale_after_s: float = param(
        5.0, unit="s", doc="An active node that received no input for so long is stale.", low=0.1, high=3600.0
    )
    vertical_offset_warn_px: float = param(
        0.3,
        unit="px",
        doc="Vertical disparity (right camera pitched) above which the calibration is warned of.",
        low=0.0,
        high=100.0,
    )
    roll_offset_warn_px: float = param(
        0.5,
        unit="px",
        doc="The same for its growth over a distance of the focal length (camera rolled).",
        low=0.0,
        high=100.0,
    )
    disparity_offset_warn_px: float = param(
        0.3, unit="px", doc="The same for the bias of the disparity (camera yawed).", low=0.0, high=100.0
    )
    memory_warn_mb: int = param(
        4000, unit="MB", doc="Resident memory of the process above which a warning is given.", low=1, high=10_000_000
    )


@dataclass(frozen=True, slots=True)
class HealthStatus:
    """Level, the reasons for it in words, and figures.

    Attributes:
        level: How well the node is.
        message: Why, the worst first.
        values: Figures by name.
        kind: Equal for two statuses between which nothing has changed but single problems and figures.
    """

    level: Level
    message: str
    values: Mapping[str, Value]
    kind: tuple[str, ...]


class State(StrEnum):
    """Primary states of a managed node (design.ros2.org, "Managed nodes")."""

    UNCONFIGURED = "unconfigured"
    INACTIVE = "inactive"
    ACTIVE = "active"
    FINALIZED = "finalized"


@dataclass(frozen=True, slots=True)
class NodeActivity:
    """What a node does at a moment.

    Attributes:
        lifecycle: One of `State`, or the state of a transition.
        counts: What was dropped since the start, by name.
        waiting: Jobs that wait for the worker.
        expects_input: Whether messages should be coming in, so that silence makes an active node stale.
        findings: What is not as it should be around the node, with its level.
    """

    lifecycle: str
    counts: Mapping[str, int]
    waiting: int
    expects_input: bool
    findings: Sequence[tuple[Level, str]] = ()


class Health:
    """Collects what happens in a node and judges it. All methods may be called in any thread."""

    def __init__(self, config: HealthConfig, clock: Callable[[], float] = time.monotonic) -> None:
        """Begin.

        Args:
            config: What is a warning.
            clock: Seconds, going forward.
        """
        self._config, self._clock = config, clock
        self._lock = Lock()
        self._process = psutil.Process()
        self.reset()

    def set_config(self, config: HealthConfig) -> None:
        """Judge by other limits from now on."""
        with self._lock:
            self._config = config

    def reset(self) -> None:
        """Forget what happened: the node has become active or inactive."""
        with self._lock:
            self._since = self._last_arrival = self._clock()
            self._arrivals: deque[float] = deque(maxlen=MAX_MOMENTS)
            self._calls: deque[float] = deque(maxlen=MAX_MOMENTS)
            self._latencies: dict[str, deque[float]] = {}
            self._problems: dict[str, tuple[float, Level, str]] = {}
            self._counts: dict[str, int] = {}
            self._drops: dict[str, float] = {}
            self._last_call: tuple[Level, str] | None = None
            self._last_values: dict[str, Value] = {}
            self._offsets: dict[str, float] = {}

    def note_arrival(self) -> None:
        """Note that input was received."""
        with self._lock:
            self._last_arrival = self._clock()
            self._remember(self._arrivals, self._last_arrival)

    def note_call(self, level: Level, state: str, values: Mapping[str, Value], statistics: Mapping[str, float]) -> None:
        """Note a call.

        Args:
            level: How good its result is.
            state: The result in one word, with its reason.
            values: Its times and memory; names that begin with `latency_` are summarised.
            statistics: Its figures; those of `OFFSETS` are watched.
        """
        with self._lock:
            self._remember(self._calls, self._clock())
            self._last_call = (level, state)
            self._last_values = {f"last_{name}": value for name, value in values.items()}
            self._offsets |= {name: float(statistics[name]) for name in OFFSETS if name in statistics}
            for name, value in values.items():
                if name.startswith("latency_"):
                    self._latencies.setdefault(name, deque(maxlen=LATENCY_WINDOW)).append(float(value))

    def note_problem(self, level: Level, text: str, kind: str = "") -> None:
        """Note something that shows for a while.

        Args:
            level: How bad it is.
            text: What it is.
            kind: Where given, it takes the place of the last one of that kind.
        """
        with self._lock:
            self._problems.pop(kind or text, None)  # the latest is last
            self._problems[kind or text] = (self._clock(), level, text)

    def judge(self, activity: NodeActivity) -> HealthStatus:
        """Judge the node by what happened and what it does at the moment."""
        with self._lock:
            now = self._clock()
            self._note_drops(activity.counts, now)
            memory = int(self._process.memory_info().rss)
            problems = self._recent_problems(now)
            lasting = self._findings(now, memory, activity)
            findings = problems + lasting
            level = max((found for found, _ in findings), key=SEVERITY.index, default=Level.OK)
            words = [text for severity in reversed(SEVERITY) for found, text in findings if found is severity]
            values: dict[str, Value] = {
                "lifecycle": activity.lifecycle,
                "received_messages_hz": self._rate(self._arrivals, now),
                "processed_hz": self._rate(self._calls, now),
                "waiting": activity.waiting,
                "resident_memory_bytes": memory,
            }
            values |= self._offsets
            values |= {n.removesuffix("_s") + "_p95_s": float(np.quantile(v, 0.95)) for n, v in self._latencies.items()}
            if len(words) > MAX_REASONS:
                words[MAX_REASONS:] = [f"and {len(words) - MAX_REASONS} more"]
            message = "; ".join(words) or (activity.lifecycle if self._last_call is None else self._last_call[1])
            kind = (activity.lifecycle, level.name, *(text for _, text in lasting))
            return HealthStatus(level, message, values | self._last_values | dict(activity.counts), kind)

    def _recent_problems(self, now: float) -> list[tuple[Level, str]]:
        """Return the problems that still show, the latest first."""
        self._problems = {key: item for key, item in self._problems.items() if now - item[0] <= self._config.window_s}
        return [(level, text) for _, level, text in reversed(self._problems.values())]

    def _findings(self, now: float, memory: int, activity: NodeActivity) -> list[tuple[Level, str]]:
        found = list(activity.findings)
        if memory > self._config.memory_warn_mb * MB:
            found.append((Level.WARN, f"more than {self._config.memory_warn_mb} MB of memory in use"))
        if activity.lifecycle != State.ACTIVE:
            return found
        if activity.expects_input and now - self._last_arrival > self._config.stale_after_s:
            found.append((Level.STALE, f"nothing came for more than {self._config.stale_after_s:g} s"))
        if self._last_call is not None and self._last_call[0] is not Level.OK:
            found.append(self._last_call)
        found += [(Level.WARN, name) for name, at in self._drops.items() if now - at <= self._config.window_s]
        for name, offset in self._offsets.items():
            limit = float(getattr(self._config, name.replace("_px", "_warn_px")))
            if abs(offset) > limit:
                found.append((Level.WARN, OFFSETS[name].format(limit)))
        return found

    def _note_drops(self, counts: Mapping[str, int], now: float) -> None:
        for name, count in counts.items():
            if count > self._counts.get(name, 0):
                self._drops[name] = now
            self._counts[name] = count

    def _remember(self, moments: deque[float], now: float) -> None:
        """Add a moment and forget those that no rate is taken over any more."""
        moments.append(now)
        while now - moments[0] > self._config.window_s:
            moments.popleft()

    def _rate(self, moments: deque[float], now: float) -> float:
        """Return how many a second there were in the window, or since the begin where that is later.

        The first second after the begin counts as a whole one: two messages within a microsecond of it are no rate.
        """
        span = min(self._config.window_s, max(now - self._since, 1.0))
        return sum(now - moment <= span for moment in moments) / span
