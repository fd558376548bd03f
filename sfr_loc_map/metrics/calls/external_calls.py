"""Time and memory of an external node among those of the calls, each named as what it is."""

from __future__ import annotations

from dataclasses import replace

from sfr_loc_map.metrics.calls.resource_score import ScoredCalls
from sfr_loc_map.metrics.modes import CallKind
from sfr_loc_map.metrics.score import ExternalScore, MemoryScore, PeakMemory

NODE_CLOCK = "as the node reports (/diagnostics)"


def with_external(scored: ScoredCalls, node: ExternalScore) -> ScoredCalls:
    """Return scored calls with the clock of an external node's own times, and the memory of its processes.

    Its latency is not among them: it is not a time per call.
    """
    kind = CallKind(node.task)
    calls = scored.timing.of(kind)
    timing = (
        scored.timing if calls is None else replace(scored.timing, **{kind.value: replace(calls, clock=NODE_CLOCK)})
    )
    return replace(scored, timing=timing, memory=_memory(scored.memory, kind, node))


def _memory(memory: MemoryScore, kind: CallKind, node: ExternalScore) -> MemoryScore:
    told = memory.of(kind)
    if node.process is None or (told is not None and told.peak_bytes is not None):
        return memory
    others = [peaks for other in CallKind if other is not kind and (peaks := memory.of(other)) is not None]
    peaks = PeakMemory(peak_bytes=node.process.peak_rss_bytes, above_idle_bytes=None)
    method = f"{kind}: {node.process.method}"
    if any(item.peak_bytes is not None for item in others):
        method += f"; others: {memory.method}"
    return replace(memory, **{kind.value: peaks}, method=method)
