"""The parts `timing`, `memory` and `target` of the score."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Annotated

from sfr_loc_map.metrics.modes import CallKind
from sfr_loc_map.metrics.records.json_records import Inline, Key
from sfr_loc_map.metrics.records.statistic_records import SampleStatistic


@dataclass(frozen=True, slots=True, kw_only=True)
class StageTime(SampleStatistic):
    """The times of one stage over the calls that had it, s.

    Attributes:
        max: Longest.
    """

    max: float


@dataclass(frozen=True, slots=True, kw_only=True)
class CallScore(SampleStatistic):
    """The wall-clock times of all calls of one kind, s [4.2.1].

    Attributes:
        p99: 99th percentile.
        max: Longest.
        first: The first call, which may load or compile.
        max_after_first: Longest of the others.
        clock: Clock they were measured with; a host time is never a time of the target.
        stages: Times of the stages of a call by name, where the calls tell them.
    """

    p99: float | None
    max: float | None
    first: float | None
    max_after_first: float | None
    clock: str
    stages: Mapping[str, StageTime] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class TimingScore:
    """The times of calls by kind [4.2.1]; None where there was none.

    Attributes:
        localisation: Pairs localised.
        mapping: Pairs mapped.
        fusion: Sets fused.
    """

    localisation: Annotated[CallScore | None, Key("localisation_s")] = None
    mapping: Annotated[CallScore | None, Key("mapping_s")] = None
    fusion: Annotated[CallScore | None, Key("fusion_s")] = None

    def of(self, kind: CallKind) -> CallScore | None:
        """Return the times of the calls of a kind."""
        return {
            CallKind.LOCALISATION: self.localisation,
            CallKind.MAPPING: self.mapping,
            CallKind.FUSION: self.fusion,
        }[kind]

    def kinds(self) -> Iterator[tuple[CallKind, CallScore]]:
        """Yield the kinds of which there were calls."""
        for kind in CallKind:
            if (calls := self.of(kind)) is not None:
                yield kind, calls


@dataclass(frozen=True, slots=True, kw_only=True)
class PeakMemory:
    """The memory of calls of one kind [4.2.2]; None where it was not measured.

    Attributes:
        peak_bytes: Largest high-water mark of resident memory of all calls.
        above_idle_bytes: The same above the idle process.
    """

    peak_bytes: int | None
    above_idle_bytes: int | None


@dataclass(frozen=True, slots=True, kw_only=True)
class MemoryScore:
    """The memory of calls by kind [4.2.2]; None where there was none.

    Attributes:
        localisation: Pairs localised.
        mapping: Pairs mapped.
        fusion: Sets fused.
        method: How it was measured; None if nothing was.
    """

    localisation: Annotated[PeakMemory | None, Inline("localisation_")] = None
    mapping: Annotated[PeakMemory | None, Inline("mapping_")] = None
    fusion: Annotated[PeakMemory | None, Inline("fusion_")] = None
    method: str | None = None

    def of(self, kind: CallKind) -> PeakMemory | None:
        """Return the memory of the calls of a kind."""
        return {
            CallKind.LOCALISATION: self.localisation,
            CallKind.MAPPING: self.mapping,
            CallKind.FUSION: self.fusion,
        }[kind]


@dataclass(frozen=True, slots=True, kw_only=True)
class TargetScore:
    """Calls that were measured elsewhere, apart from those of this host [4.3.1, 4.3.2].

    Attributes:
        name: Name of the target.
        timing: Times.
        memory: Memory, without kinds and method where it was not measured.
    """

    name: str
    timing: TimingScore
    memory: MemoryScore
