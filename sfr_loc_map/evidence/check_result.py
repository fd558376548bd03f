"""Results of a check without ground truth. They follow from the figures of the check, and from the advice.

Three kinds of evidence decide, each about one subject:

- drive: the probability of each comparison of the localiser's own runs (figure `agreement`), over sub-trajectories and
  at revisited places. Comparisons with other estimates contribute figures only.
- maps: the ratios of each overlap of two maps (figures `overlap`, `overlap_ratio`, `overlap_grey`)
- calibration: the advice for the calibration file

A check and the report of its JSON file both call `results_of`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

from sfr_loc_map.errors import InputError
from sfr_loc_map.evidence.calibration import Advice, CameraOffset
from sfr_loc_map.evidence.localiser_runs import OWN_COMPARISONS
from sfr_loc_map.mapping.multiview.pose_agreement import pose_disagreement
from sfr_loc_map.mapping.multiview.projection import MIN_OVERLAP
from sfr_loc_map.metrics.figures.rows import Figure

DRIVE, MAPS, CALIBRATION = "drive", "maps", "calibration"  #: Subjects of a check.
SCHEMA = "sfr-check/1"  #: Schema of the JSON of a check.
SIGNIFICANCE = 0.05  #: Probability of a false finding over all comparisons of a recording.


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

    subject: str  #: `DRIVE` or `MAPS`.
    figures: tuple[Figure, ...]
    pairs: int  #: Number of pairs that were checked.
    pairs_of_source: int  #: Number of pairs that the source has.
    disagreements: tuple[str, ...] = ()
    """Descriptions of differences that exceed the prediction: the least probable difference of a drive, and all of
    the maps."""
    shortage: str = ""  #: Why there is not enough data; empty for other results.
    offsets: tuple[CameraOffset, ...] = ()  #: Offsets of the right camera from its calibration, of a drive.

    @property
    def results(self) -> tuple[CheckResult, ...]:
        """The result of each comparison."""
        return results_of_comparisons(self.figures)[self.subject]

    @property
    def result(self) -> CheckResult:
        """The result over all comparisons."""
        return combined(self.results)

    @property
    def checked(self) -> int:
        """Number of comparisons with enough data."""
        return count_with_enough_data(self.results)

    @property
    def wrong_offsets(self) -> tuple[CameraOffset, ...]:
        """The offsets for which the calibration should be repeated."""
        return tuple(offset for offset in self.offsets if offset.is_wrong)

    @property
    def advice(self) -> dict[str, Advice]:
        """The recommended action for the calibration file, by angle."""
        return {offset.angle: offset.advice for offset in self.offsets}


def results_of(
    subjects: Iterable[str], figures: Sequence[Figure], advice: Mapping[str, Advice]
) -> dict[str, CheckResult]:
    """Return the result of each checked subject; the calibration has a result only if it should be repeated."""
    comparisons = results_of_comparisons(figures)
    results = {subject: combined(comparisons[subject]) for subject in subjects}
    if Advice.REDO in advice.values():
        results[CALIBRATION] = CheckResult.INCONSISTENT
    return results


def results_of_comparisons(figures: Sequence[Figure]) -> dict[str, tuple[CheckResult, ...]]:
    """Return the results of the comparisons of the drive and of the maps."""
    own = [row.value for row in figures if row.figure == "agreement" and row.part in OWN_COMPARISONS]
    return {DRIVE: results_of_probabilities(own), MAPS: tuple(_results_of_overlaps(figures))}


def results_of_probabilities(probabilities: Sequence[float | None]) -> tuple[CheckResult, ...]:
    """Return the result of comparisons by their probabilities; an unknown or undefined probability has too few data.

    The significance is divided by the number of known probabilities (Bonferroni).
    """
    known = [None if value is None or not math.isfinite(value) else value for value in probabilities]
    count = sum(value is not None for value in known)
    results = []
    for value in known:
        if value is None:
            results.append(CheckResult.NOT_ENOUGH_DATA)
        elif value * count < SIGNIFICANCE:
            results.append(CheckResult.INCONSISTENT)
        else:
            results.append(CheckResult.CONSISTENT)
    return tuple(results)


def _results_of_overlaps(figures: Sequence[Figure]) -> Iterator[CheckResult]:
    """Yield the result of each two maps that overlap."""
    ratios = {row.part: row.value for row in figures if row.figure == "overlap_ratio"}
    grey_ratios = {row.part: row.value for row in figures if row.figure == "overlap_grey"}
    for row in figures:
        if row.figure != "overlap":
            continue
        ratio = ratios.get(row.part)
        grey_ratio = grey_ratios.get(row.part)
        if ratio is None:
            raise InputError(f"the check has no figure 'overlap_ratio' for '{row.part}': give a file of sfr check")
        yield result_of_overlap(row.n or 0, ratio, math.nan if grey_ratio is None else grey_ratio)


def result_of_overlap(points: int, ratio: float, grey_ratio: float) -> CheckResult:
    """Return the result for two maps by the criteria of the fusion; `grey_ratio` is NaN without texture."""
    if points < MIN_OVERLAP:
        return CheckResult.NOT_ENOUGH_DATA
    disagrees = pose_disagreement(ratio, grey_ratio) != ""
    return CheckResult.INCONSISTENT if disagrees else CheckResult.CONSISTENT


def count_with_enough_data(results: Iterable[CheckResult]) -> int:
    """Return the number of comparisons with enough data."""
    return sum(result is not CheckResult.NOT_ENOUGH_DATA for result in results)


def combined(results: Iterable[CheckResult], precedence: Sequence[CheckResult] = OF_COMPARISONS) -> CheckResult:
    """Return the result that comes first in the precedence; without results, there is not enough data."""
    found = set(results)
    return next((result for result in precedence if result in found), CheckResult.NOT_ENOUGH_DATA)
