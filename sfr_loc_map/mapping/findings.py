"""Findings of a call: statistics (numbers by name), and warnings about input that degrades the map.

Add a new finding of one pair to `pair_findings`, and a new finding of a set of pairs to the result of its stage in
`multiview`. `Mapper.fuse` combines the findings of all stages. The names of statistics are public and therefore fixed:
`share` means a fraction, `matched_share` is `MeasuredDisparity.measured_textured_fraction`, and `merged` is the number
of points with which another pair agrees, including dropped points.
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
        """Return the combined findings; raises ValueError if both have a statistic of the same name."""
        common = self.statistics.keys() & other.statistics.keys()
        if common:
            raise ValueError(f"two stages have statistics of the same name: {', '.join(sorted(common))}")
        return Findings({**self.statistics, **other.statistics}, self.warnings + other.warnings)
