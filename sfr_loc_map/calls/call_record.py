"""The record of a call of localiser or mapper. `call_message` is the record as JSON."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.io.stamps.stamp_text import STAMP_LIMIT
from sfr_loc_map.localisation.estimate import PoseEstimate, TrackingState
from sfr_loc_map.metrics.calls.call_meter import CallUsage
from sfr_loc_map.metrics.calls.calls import LOCALISER_STATES, MAX_NUMBER, STATE_KINDS
from sfr_loc_map.metrics.config import MappingState
from sfr_loc_map.metrics.frames.covariance import DIAGONAL, check_variances, step_variances
from sfr_loc_map.suite_names import Task

if TYPE_CHECKING:
    from sfr_loc_map.mapping.maps import FusedMap

STATES_OF: dict[Task, tuple[str, ...]] = {Task.LOCALISATION: LOCALISER_STATES, Task.MAPPING: tuple(STATE_KINDS)}
"""States of the calls of each task; empty: unknown."""
DEFAULT_STATE = {Task.LOCALISATION: "", Task.MAPPING: MappingState.MAPPED.value}
"""State of a call whose external node reports no state, by task. The empty state of a localiser means unknown."""
UNKNOWN_TIME_S = 0.0
"""Processing time, s, of a call whose time is unknown, in JSON. A zero in a file also means that the time is unknown;
`CallRecord` has None, and files and `CallStats` have NaN."""
MAX_CALL_S = 1e6  #: Maximum processing time of a received call, s.
MANY = 0.05  #: Minimum fraction of lost or degraded pairs for a warning.
ASYMMETRY = 1e-6  #: Maximum difference of symmetric numbers of a covariance, relative to its largest number.
Stamp = Annotated[int, Meta(ge=0, lt=STAMP_LIMIT)]
Bytes = Annotated[int, Meta(ge=0, le=int(MAX_NUMBER))]
Name = Annotated[str, Meta(max_length=100)]
Text = Annotated[str, Meta(max_length=2000)]
Hash = Annotated[str, Meta(pattern="^([0-9a-f]{64})?$")]


@dataclass(frozen=True, slots=True, eq=False)
class CallRecord:
    """One call of localiser or mapper; `encode_call` and `decode_call` convert it for `<node>/call`.

    The table in `sfr_loc_map.calls` states which fields the other forms of a call have.
    """

    stamp_ns: Stamp  #: Stamp of the pair; for a fused cloud, of its last pair.
    processing_time_s: Annotated[float, Meta(ge=0.0, le=MAX_CALL_S)] | None  #: Wall-clock time; None if unknown.
    state: Text = ""  #: State after the call: initialising, tracking, degraded, lost; mapped, fused, mapped_set.
    _: KW_ONLY
    #: Peak resident memory of the process during the call; None if it cannot be measured.
    peak_rss_bytes: Bytes | None = None
    above_idle_bytes: Bytes | None = None  #: Peak above the memory of the idle process.
    statistics: Mapping[Name, float] = field(default_factory=dict)  #: Statistics of the call by name.
    covariance: FloatArray | None = None  #: `(6, 6)` of the pose (ROS order), None for mapping.
    reason: Text = ""  #: Why the pose is degraded or lost, in one word.
    #: `(48,)`: upper triangle of the covariance of the motion since the previous pose, in RB at that pose (21); one
    #: standard deviation of the error that all motions share (6); upper triangle of the pose noise (21). None: unknown.
    step: FloatArray | None = None
    finding: Text = ""  #: Errors of the method in this call (`CallFinding`).
    pair_stamps_ns: tuple[Stamp, ...] = ()  #: Stamps of the pairs of a fused cloud, in the order of the points' `pair`.
    fused: bool | None = None  #: Whether the cloud contains each surface once; None if the mapper does not report it.
    #: Times around the call, s: decoding, latencies. `times` and `counts` are shown live but not written to files.
    times: Mapping[str, float] = field(default_factory=dict)
    counts: Mapping[str, Annotated[int, Meta(ge=0)]] = field(
        default_factory=dict
    )  #: Messages dropped since the configuration, by cause.
    version: Text = ""  #: Version of the method, if a node reports it.
    images_sha256: Hash = ""  #: Hash of the images of the call (`run_identity`); empty if unknown.

    @property
    def task(self) -> Task:
        """Task of the node that made the call."""
        return task_of(self.state)

    @property
    def outcome(self) -> str:
        """State after the call with its reason, for display."""
        return outcome_text(self.state, self.reason)

    @property
    def is_fused(self) -> bool:
        """Whether the cloud of a fusion contains each surface once; true by default for several pairs."""
        return len(self.pair_stamps_ns) > 1 if self.fused is None else self.fused


def task_of(state: str) -> Task:
    """Return the task of a call from its state; an unknown state (empty) is that of a localiser."""
    return Task.MAPPING if state in STATE_KINDS else Task.LOCALISATION


def outcome_text(state: str, reason: str) -> str:
    """Return a state with its reason, if any, for display."""
    return f"{state}: {reason}" if reason else state


def usage_of_stages(stages: Sequence[CallRecord | CallUsage]) -> CallUsage:
    """Return the usage of a mapping call from its stages: each pair and the fusion.

    The time is the sum of the times of the stages, None if one of them is unknown. The time between stages does not
    count, such as the wait for the next pair. The memory is the maximum over the stages whose peak was measured. The
    memory above the idle process is None if one of these stages lacks it.
    """
    times_s = [item.processing_time_s for item in stages if item.processing_time_s is not None]
    peaks = [item.peak_rss_bytes for item in stages if item.peak_rss_bytes is not None]
    above_idle = [item.above_idle_bytes for item in stages if item.above_idle_bytes is not None]
    return CallUsage(
        processing_time_s=sum(times_s) if len(times_s) == len(stages) else None,
        peak_rss_bytes=max(peaks, default=None),
        above_idle_bytes=max(above_idle, default=None) if len(above_idle) == len(peaks) else None,
    )


def call_of_estimate(
    estimate: PoseEstimate,
    usage: CallUsage,
    more: Mapping[str, float] = MappingProxyType({}),
    *,
    images_sha256: str = "",
) -> CallRecord:
    """Return the record of the localiser's call that gave an estimate, with further statistics."""
    return CallRecord(
        estimate.stamp_ns,
        usage.processing_time_s,
        estimate.state.value,
        peak_rss_bytes=usage.peak_rss_bytes,
        above_idle_bytes=usage.above_idle_bytes,
        statistics=estimate.figures | dict(more),
        covariance=estimate.covariance,
        reason=estimate.reason_text,
        step=None if estimate.step is None else estimate.step.uncertainty,
        images_sha256=images_sha256,
    )


def mapping_call(
    stamp_ns: int,
    usage: CallUsage,
    state: MappingState,
    statistics: Mapping[str, float] = MappingProxyType({}),
    finding: str = "",
    *,
    images_sha256: str = "",
) -> CallRecord:
    """Return the record of a mapper's call for the pair of a stamp, or for a map whose last pair has the stamp."""
    return CallRecord(
        stamp_ns,
        usage.processing_time_s,
        state.value,
        peak_rss_bytes=usage.peak_rss_bytes,
        above_idle_bytes=usage.above_idle_bytes,
        statistics=statistics,
        finding=finding,
        images_sha256=images_sha256,
    )


def call_of_fusion(fused: FusedMap, stamps_ns: Sequence[int], usage: CallUsage, state: MappingState) -> CallRecord:
    """Return the record of a mapper's call that fused pairs; `stamps_ns` is in the order of the points' `pair`."""
    call = mapping_call(stamps_ns[-1], usage, state, fused.statistics)
    return replace(call, pair_stamps_ns=tuple(stamps_ns), fused=fused.cloud.fused)


def is_covariance_reported(covariance: FloatArray) -> NDArray[np.bool_]:
    """Return which covariances `(N, 21)` are reported.

    A covariance is not reported if it is zero (the default of ROS messages) or NaN, or if a variance is negative, by
    which some publishers mark an unknown covariance.
    """
    has_number = (np.nan_to_num(covariance) != 0.0).any(axis=1)
    is_negative = (covariance[:, DIAGONAL] < 0.0).any(axis=1)
    return np.asarray(has_number & ~is_negative)


def bounded(covariance: FloatArray) -> FloatArray:
    """Return covariances whose magnitudes are limited to `MAX_NUMBER`, which keeps the mark of a lost pose."""
    return np.clip(covariance, -MAX_NUMBER, MAX_NUMBER)


def first_reported(published: FloatArray | None, of_calls: FloatArray | None) -> FloatArray | None:
    """Return the covariances `(N, 21)` of poses: the published one if reported, otherwise that of the call.

    Magnitudes above `MAX_NUMBER` are replaced by `MAX_NUMBER`. A row is NaN if neither covariance is reported, and the
    result is None if none is reported for any pose.
    """
    found: FloatArray | None = None
    for covariance in (of_calls, published):  # a published covariance replaces that of the call
        if covariance is None or not (is_reported := is_covariance_reported(covariance)).any():
            continue
        otherwise = np.full_like(covariance, np.nan) if found is None else found
        found = np.where(is_reported[:, None], bounded(covariance), otherwise)
    return found


def states_text(records: Sequence[CallRecord]) -> str:
    """Return the text of the numbers of lost and, if any, degraded calls of the localiser."""
    counts = Counter(record.state for record in records)
    degraded = counts[TrackingState.DEGRADED]
    return f"{counts[TrackingState.LOST]} lost" + (f", {degraded} degraded" if degraded else "")


def tracking_warning(records: Sequence[CallRecord], source: object, *, is_ours: bool = True) -> str | None:
    """Return a warning with the most frequent reason if many pairs are lost or degraded, None otherwise.

    `is_ours` is whether the calls are those of the suite's localiser, whose tracks a video can show.
    """
    bad = [record for record in records if record.state in (TrackingState.LOST, TrackingState.DEGRADED)]
    if not bad or len(bad) < MANY * len(records):
        return None
    reason, count = Counter(record.reason for record in bad).most_common(1)[0]
    why = f"most often ({count} pairs) because of '{reason}'" if reason else "without a stated reason"
    path = shlex.quote(str(source))
    video = f", or sfr localise {path} -o again.csv --video tracks.avi" if is_ours else ""
    return f"{states_text(records)} of {len(records)} pairs, {why}: inspect with sfr info {path}{video}"


def check_uncertainty(record: CallRecord) -> None:
    """Raise ValueError if the covariance of a call is not symmetric, or if it or the step has a negative variance."""
    if record.covariance is not None:
        covariance = bounded(record.covariance)
        check_variances("covariance", np.diag(covariance))
        if (np.abs(covariance - covariance.T) > ASYMMETRY * np.abs(covariance).max()).any():
            raise ValueError("'covariance' is not symmetric: a symmetric matrix of 6 x 6 is required")
    if record.step is not None:
        check_variances("step", step_variances(record.step))
