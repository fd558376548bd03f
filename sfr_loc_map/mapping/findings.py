"""Findings of a call: statistics (numbers by name), and warnings about input that degrades the map.

`pair_findings` computes the findings of one pair. Each stage of `multiview` returns findings of a set of pairs, and
`Mapper.fuse` combines them. The names of statistics are public and therefore fixed: `share` means a fraction,
`matched_share` is `DisparityMap.measured_textured_fraction`, and `merged` is the number of points with which another
pair agrees, including dropped points.
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
        """Return the combined findings."""
        return Findings({**self.statistics, **other.statistics}, self.warnings + other.warnings)
