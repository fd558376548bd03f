"""Time, memory and result of one call of the processing API, to /diagnostics and back."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from threading import Lock
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.metrics.resources import CallMeter, CallUsage
from sfr_loc_map.nodes.diagnostics.key_values import TOPIC, Level, Value, array_msg, call_name, status_msg, values_of
from sfr_loc_map.nodes.messages.fields import header_msg
from sfr_loc_map.pipeline.call_stats import STATISTIC, TaskRecord, call_of

_ONE_AT_A_TIME = Lock()
"""Time and memory are those of the whole process: nodes that share one take turns."""


@dataclass(frozen=True, slots=True)
class Call:
    """One call of the processing API, as the node saw it.

    Attributes:
        stamp_ns: Stamp of the pair.
        usage: Its time and memory.
        state: Its result in one word (tracking, degraded, lost, mapped, ...).
        level: How good that is.
        statistics: Its figures by name.
        times: Times around it, seconds, by name.
        reason: Why it is degraded or lost, in one word; empty otherwise.
        step: `(27,)` of the localiser, as in `CallRecord`; None where there is none.
    """

    stamp_ns: int
    usage: CallUsage
    state: str
    level: Level
    statistics: Mapping[str, float]
    times: Mapping[str, float] = field(default_factory=dict)
    reason: str = ""
    step: FloatArray | None = None

    @property
    def result(self) -> str:
        """The state with its reason."""
        return f"{self.state}: {self.reason}" if self.reason else self.state


class CallReporter:
    """Measures the calls of one node and publishes them."""

    def __init__(self, node: Node, task: str, publisher: Any) -> None:  # noqa: ANN401 - rclpy has no types
        """Take the present memory as that of the idle process.

        Args:
            node: The node.
            task: `localisation` or `mapping`.
            publisher: The node's publisher of /diagnostics.
        """
        self._node, self._task, self._publisher = node, task, publisher
        self._meter = CallMeter()

    @contextmanager
    def measure(self) -> Iterator[CallUsage]:
        """Measure the `with` block."""
        with _ONE_AT_A_TIME, self._meter.measure() as usage:
            yield usage

    def publish(self, call: Call, counts: Mapping[str, int]) -> dict[str, Value]:
        """Publish one call; return its times and memory, by name.

        Args:
            call: The call.
            counts: Counts since the start of the node.
        """
        usage = call.usage
        took: dict[str, Value] = {"processing_time_s": usage.processing_time_s}
        if usage.peak_rss_bytes is not None and usage.above_idle_bytes is not None:
            took |= {"peak_rss_bytes": usage.peak_rss_bytes, "above_idle_bytes": usage.above_idle_bytes}
        took |= dict(call.times)
        values: dict[str, Value] = {
            "task": self._task,
            "stamp_ns": call.stamp_ns,
            "state": call.state,
            "reason": call.reason,
            "memory_method": self._meter.method,
            **took,
        }
        values |= {STATISTIC + name: float(value) for name, value in call.statistics.items()}
        if call.step is not None:
            values["step"] = " ".join(map(repr, call.step.tolist()))
        values |= dict(counts)
        name = call_name(self._node.get_fully_qualified_name())
        self._publisher.publish(
            array_msg(header_msg(call.stamp_ns, ""), status_msg(name, call.level, call.result, values))
        )
        return took


def task_record(status: DiagnosticStatus) -> TaskRecord | None:
    """Return the call that a status describes, None where it describes something else.

    Raises:
        InputError: If it is such a status but a value is missing or no number.
    """
    try:
        return call_of(values_of(status))
    except InputError as error:
        raise InputError(f"status '{status.name}' on {TOPIC} cannot be read: {error}") from error
