"""Results of checks without a ground truth, and how the results of comparisons are combined."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

from sfr_loc_map.metrics.table.rows import Figure


class CheckResult(StrEnum):
    """Result of a check without a ground truth. It never shows that a limit is met."""

    CONSISTENT = "consistent"
    INCONSISTENT = "inconsistent"
    NOT_ENOUGH_DATA = "not enough data"


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """The check of one subject: a drive or maps."""

    results: tuple[CheckResult, ...]  #: The result of each comparison.
    figures: tuple[Figure, ...]
    disagreements: tuple[str, ...]
    """Differences that exceed the prediction, one phrase each: for a drive the least probable difference, for maps
    all."""

    @property
    def result(self) -> CheckResult:
        """The result over all comparisons."""
        return combined(self.results)

    @property
    def checked(self) -> int:
        """Number of comparisons with enough data."""
        return sum(result is not CheckResult.NOT_ENOUGH_DATA for result in self.results)


def combined(results: Iterable[CheckResult]) -> CheckResult:
    """Return the result over several comparisons: the worst result of those with enough data.

    The number of comparisons with enough data belongs beside the result (`Check.checked`).
    """
    found = set(results)
    order = (CheckResult.INCONSISTENT, CheckResult.CONSISTENT)
    return next((result for result in order if result in found), CheckResult.NOT_ENOUGH_DATA)
