"""Which stereo pairs each published cloud is made of, from the calls of the mapper."""

from __future__ import annotations

from dataclasses import dataclass

from sfr_loc_map.mapping.config import MAX_PAIRS
from sfr_loc_map.metrics.config import MappingState
from sfr_loc_map.pipeline.call_record import CallRecord


@dataclass(frozen=True, slots=True)
class PairSet:
    """The pairs of one cloud.

    Attributes:
        stamps_ns: Their stamps, in the order of the points' `pair`.
        fused: Whether the mapper says that the cloud is fused. Of a mapper that does not say so `mapping/points` is by
            contract the fused cloud, and one of a single pair has nothing to fuse.
    """

    stamps_ns: tuple[int, ...]
    fused: bool


class PairSets:
    """Collects the calls of the mapper in their order."""

    def __init__(self) -> None:
        """Start before the first pair."""
        self._mapped_ns: list[int] = []

    def add(self, record: CallRecord) -> PairSet | None:
        """Add a call; return the pairs of the cloud if it was a fusion whose pairs are all known.

        A fusion tells how many pairs it is made of: those mapped for a map that was given up do not count.
        """
        if record.state == MappingState.MAPPED:
            self._mapped_ns.append(record.stamp_ns)
            del self._mapped_ns[:-MAX_PAIRS]
        if record.state != MappingState.FUSED:
            return None
        stamps, self._mapped_ns = tuple(self._mapped_ns), []
        count = int(record.statistics.get("pairs", len(stamps)))
        if not 1 <= count <= len(stamps):
            return None
        fused = record.statistics.get("fused")
        return PairSet(stamps[-count:], count > 1 if fused is None else bool(fused))
