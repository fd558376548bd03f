"""Time, memory and state of one call, offline and over topics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from sfr_loc_map.geometry.arrays import FloatArray


@dataclass(frozen=True, slots=True)
class CallRecord:
    """One call of a processing API.

    Attributes:
        stamp_ns: Stamp of the pair.
        processing_time_s: Wall-clock time of the call on this host.
        state: State after the call: initialising, tracking, degraded, lost; mapped, fused.
        peak_rss_bytes: Peak resident memory of the process during the call, None where it cannot be measured.
        above_idle_bytes: The same above the idle process, None where it cannot be measured.
        statistics: Figures of the call by name.
        covariance: `(6, 6)` of the pose (ROS order), None for mapping.
        step: `(27,)` upper triangle of the covariance of the motion since the pose before, in RB there, then one
            standard deviation of the error that all such motions have alike; None where not known.
        reason: Why it is degraded or lost, in one word; empty otherwise.
        finding: What the method did wrong in this call, `KIND: text`; empty for nothing.
    """

    stamp_ns: int
    processing_time_s: float
    state: str
    peak_rss_bytes: int | None
    above_idle_bytes: int | None
    statistics: Mapping[str, float] = field(default_factory=dict)
    covariance: FloatArray | None = None
    reason: str = ""
    step: FloatArray | None = None
    finding: str = ""
