"""Findings on a method, counted by their kind."""

from __future__ import annotations

from collections.abc import Iterable

from msgspec.structs import replace

from sfr_loc_map.metrics.figures.records import CallFinding, FindingKind, FindingRecord


class FindingCounts:
    """Counts the findings of each kind; stamp and text are those of the first finding of the kind."""

    def __init__(self) -> None:
        """Start without findings."""
        self._counted: dict[FindingKind, FindingRecord] = {}

    def add(self, kind: FindingKind, stamp_ns: int, text: str) -> None:
        """Count a finding at a stamp."""
        first = self._counted.get(kind) or FindingRecord(kind=kind, count=0, first_stamp_ns=stamp_ns, text=text)
        self._counted[kind] = replace(first, count=first.count + 1)

    def add_of_call(self, stamp_ns: int, text: str) -> None:
        """Count the findings in the text of a call (`CallFinding`); other texts are ignored."""
        for kind, about in CallFinding.all_in(text):
            self.add(kind, stamp_ns, about)

    def count(self, kind: FindingKind) -> int:
        """Return the number of findings of a kind."""
        return self._counted[kind].count if kind in self._counted else 0

    @property
    def records(self) -> tuple[FindingRecord, ...]:
        """One record for each kind, in the order of the first findings."""
        return tuple(self._counted.values())


def findings_of(calls: Iterable[tuple[int, str]]) -> tuple[FindingRecord, ...]:
    """Return the findings of calls, given by stamp and text, one record for each kind; other texts are ignored."""
    counts = FindingCounts()
    for stamp_ns, text in calls:
        counts.add_of_call(stamp_ns, text)
    return counts.records
