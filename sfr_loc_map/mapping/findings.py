"""Findings of a call: statistics, which are numbers by name, and warnings about input that gives a poor map.

A new finding of one pair belongs to `pair_findings`. One of a set of pairs belongs to the findings that its stage in
`multiview` returns; `Mapper.fuse` adds those of all stages. Statistics are public keys, which are not renamed: `share`
is a fraction, and `merged` the number of points that another pair agrees with.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class Findings:
    """Statistics and warnings of a call or of one of its stages."""

    statistics: Mapping[str, float] = field(default_factory=dict)  #: Numbers by name.
    warnings: tuple[str, ...] = ()  #: One line each.

    def __add__(self, other: Findings) -> Findings:
        """Return the findings of both; ValueError if both have a statistic of one name."""
        common = self.statistics.keys() & other.statistics.keys()
        if common:
            raise ValueError(f"two stages have statistics of the same name: {', '.join(sorted(common))}")
        return Findings({**self.statistics, **other.statistics}, self.warnings + other.warnings)
