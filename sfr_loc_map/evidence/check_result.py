"""Results of checks without a ground truth, and how the results of a drive and of maps are combined."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

from sfr_loc_map.metrics.table import Figure


class CheckResult(StrEnum):
    """Result of a check without a ground truth. It never shows that a limit is met."""

    CONSISTENT = "consistent"
    INCONSISTENT = "inconsistent"
    NOT_ENOUGH_DATA = "not enough data"


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """The check of one subject: a drive or maps."""

    result: CheckResult
    figures: tuple[Figure, ...]
    disagreements: tuple[str, ...]
    """Differences that exceed the prediction, one phrase each: for a drive the least probable difference, for maps
    all."""


def worst_result(results: Iterable[CheckResult]) -> CheckResult:
    """Return the worst result of the checks of several subjects; without any check, there is not enough data."""
    found = set(results)
    worst_first = (CheckResult.INCONSISTENT, CheckResult.NOT_ENOUGH_DATA, CheckResult.CONSISTENT)
    return next((result for result in worst_first if result in found), CheckResult.NOT_ENOUGH_DATA)
