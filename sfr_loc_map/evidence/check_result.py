"""Results of checks without a ground truth, and how results of comparisons and of subjects are combined."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum

from sfr_loc_map.metrics.figures.rows import Figure

DRIVE, MAPS, CALIBRATION = "drive", "maps", "calibration"  #: Subjects of a check.
SCHEMA = "sfr-check/1"  #: Schema of the JSON of a check.


class CheckResult(StrEnum):
    """Result of a check without a ground truth. It never shows that a limit is met."""

    CONSISTENT = "consistent"
    INCONSISTENT = "inconsistent"
    NOT_ENOUGH_DATA = "not enough data"


OF_COMPARISONS = (CheckResult.INCONSISTENT, CheckResult.CONSISTENT, CheckResult.NOT_ENOUGH_DATA)
"""Precedence of the results of comparisons: a comparison without enough data does not change the result of the others.
The number of comparisons with enough data is stated beside the result (`Check.checked`)."""
OF_SUBJECTS = (CheckResult.INCONSISTENT, CheckResult.NOT_ENOUGH_DATA, CheckResult.CONSISTENT)
"""Precedence of the results of subjects: a recording is consistent only if each of its subjects could be checked."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """The check of one subject: a drive or maps."""

    results: tuple[CheckResult, ...]  #: The result of each comparison.
    figures: tuple[Figure, ...]
    pairs: int  #: Number of pairs that were checked.
    pairs_of_source: int  #: Number of pairs that the source has.
    disagreements: tuple[str, ...]
    """Descriptions of differences that exceed the prediction: the least probable difference of a drive, and all of
    the maps."""
    shortage: str = ""  #: Why there is not enough data; empty for other results.

    @property
    def result(self) -> CheckResult:
        """The result over all comparisons."""
        return combined(self.results)

    @property
    def checked(self) -> int:
        """Number of comparisons with enough data."""
        return count_with_enough_data(self.results)


def count_with_enough_data(results: Iterable[CheckResult]) -> int:
    """Return the number of comparisons with enough data."""
    return sum(result is not CheckResult.NOT_ENOUGH_DATA for result in results)


def combined(results: Iterable[CheckResult], precedence: Sequence[CheckResult] = OF_COMPARISONS) -> CheckResult:
    """Return the result that comes first in the precedence; without results, there is not enough data."""
    found = set(results)
    return next((result for result in precedence if result in found), CheckResult.NOT_ENOUGH_DATA)
