"""The check of a recording without ground truth, and its results, which follow from its figures and its advice.

Three kinds of evidence decide, each about one subject:

- drive: the probability of each comparison of the localiser's own runs (figure `agreement`), over sub-trajectories and
  at revisited places. Comparisons with other estimates contribute figures only.
- maps: the ratios of each overlap of two maps (figures `overlap`, `overlap_ratio`, `overlap_grey`)
- calibration: the advice for the calibration file

A `Check` is also the content of the JSON of `sfr check`. The results in the file are for readers: a report derives the
results again from the figures.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from enum import StrEnum
from typing import Any

import msgspec

from sfr_loc_map.errors import InputError
from sfr_loc_map.evidence.calibration import Advice
from sfr_loc_map.evidence.localiser_runs import OWN_COMPARISONS
from sfr_loc_map.mapping.multiview.pose_agreement import pose_disagreement
from sfr_loc_map.mapping.multiview.projection import MIN_OVERLAP
from sfr_loc_map.metrics.figures.records import Provenance
from sfr_loc_map.metrics.figures.rows import Figure
from sfr_loc_map.metrics.stored.score_json import HASH, hash_of_values, to_plain

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
The number of comparisons with enough data is stated beside the result (`Check.counts`)."""
OF_SUBJECTS = (CheckResult.INCONSISTENT, CheckResult.NOT_ENOUGH_DATA, CheckResult.CONSISTENT)
"""Precedence of the results of subjects: a recording is consistent only if each of its subjects could be checked."""


class Check(msgspec.Struct, frozen=True, kw_only=True):
    """The check of a recording: of its drive, of its maps, or of both. A subject is `DRIVE` or `MAPS`."""

    pairs: dict[str, int]  #: Number of checked pairs of each subject.
    pairs_of_source: dict[str, int]  #: Number of pairs that the source has for each subject.
    figures: tuple[Figure, ...]
    advice: dict[str, Advice] = {}  #: Recommended action for the calibration file, by angle of the right camera.
    calibration: tuple[str, ...] = ()  #: Offsets of the right camera for which the calibration should be repeated.
    disagreements: tuple[str, ...] = ()
    """Descriptions of differences that exceed the prediction: the least probable difference of a drive, and all of
    the maps."""
    not_checked: tuple[str, ...] = ()  #: Why subjects do not have enough data.
    provenance: Provenance | None = None  #: Inputs, command, settings, version and time; None if unknown.

    @property
    def results(self) -> dict[str, CheckResult]:
        """The result of each subject; the calibration has a result only if it should be repeated."""
        comparisons = results_of_comparisons(self.figures)
        results = {subject: combined(comparisons[subject]) for subject in self.pairs}
        if Advice.REDO in self.advice.values():
            results[CALIBRATION] = CheckResult.INCONSISTENT
        return results

    @property
    def result(self) -> CheckResult:
        """The result of the recording: not enough data if a subject was not checked and no other subject disagrees."""
        return combined(self.results.values(), OF_SUBJECTS)

    @property
    def counts(self) -> dict[str, tuple[int, int]]:
        """For each subject, the number of comparisons with enough data, and the number of all comparisons."""
        comparisons = results_of_comparisons(self.figures)
        counts = {}
        for subject in self.pairs:
            results = comparisons[subject]
            enough = sum(result is not CheckResult.NOT_ENOUGH_DATA for result in results)
            counts[subject] = (enough, len(results))
        return counts

    @property
    def checked(self) -> dict[str, str]:
        """The counts in words."""
        return {subject: f"{enough} of {count}" for subject, (enough, count) in self.counts.items()}

    def to_dict(self) -> dict[str, Any]:
        """Return the check for JSON, with its results and the hash of all values."""
        content = {
            "schema": SCHEMA,
            "result": self.result.value,
            "results": {subject: result.value for subject, result in self.results.items()},
            "checked": self.checked,
            **to_plain(self),
        }
        return {**content, HASH: hash_of_values(content)}


def joined(checks: Sequence[Check]) -> Check:
    """Return the check of several subjects of a recording from the check of each subject."""
    return Check(
        pairs={subject: count for check in checks for subject, count in check.pairs.items()},
        pairs_of_source={subject: count for check in checks for subject, count in check.pairs_of_source.items()},
        figures=tuple(row for check in checks for row in check.figures),
        advice={angle: word for check in checks for angle, word in check.advice.items()},
        calibration=tuple(text for check in checks for text in check.calibration),
        disagreements=tuple(text for check in checks for text in check.disagreements),
        not_checked=tuple(text for check in checks for text in check.not_checked),
    )


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


def combined(results: Iterable[CheckResult], precedence: Sequence[CheckResult] = OF_COMPARISONS) -> CheckResult:
    """Return the result that comes first in the precedence; without results, there is not enough data."""
    found = set(results)
    return next((result for result in precedence if result in found), CheckResult.NOT_ENOUGH_DATA)
