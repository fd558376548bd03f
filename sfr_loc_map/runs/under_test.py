"""What the runs of localisers and mappers share: a method under test in place of ours, and the progress."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from sfr_loc_map.methods.registry import Method, MethodLimits

Progress = Callable[[int], None]
"""Function that receives the number of finished pairs after each pair."""


@dataclass(frozen=True, slots=True)
class UnderTest:
    """A method under test, in place of the localiser or mapper of the suite."""

    method: Method
    limits: MethodLimits = field(default_factory=MethodLimits)
    hidden: Sequence[Path] = field(kw_only=True)  #: Paths to which the method has no access: `Source.truth_paths`.
