"""Results of a stored check, derived again from its figures. A contradiction shows that the file was edited."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

from sfr_loc_map.errors import InputError
from sfr_loc_map.evidence.agreement import MIN_SUB_TRAJECTORIES, probability_of_sum, results_of_probabilities
from sfr_loc_map.evidence.calibration import LARGE_PX, Advice
from sfr_loc_map.evidence.check import COMPARED
from sfr_loc_map.evidence.check_result import CALIBRATION, DRIVE, MAPS, CheckResult, combined
from sfr_loc_map.evidence.overlap import result_of
from sfr_loc_map.evidence.revisited import DIRECT
from sfr_loc_map.evidence.variants import Variant
from sfr_loc_map.metrics.figures.rows import Figure

TOLERANCE = 1e-6  #: Largest relative difference of a derived probability, because the stored mean is rounded.
OWN_COMPARISONS = frozenset(" - ".join(runs) for runs in (*COMPARED, (Variant.FORWARD, DIRECT)))
"""Names of the comparisons of the localiser's own runs."""
Key = tuple[str | None, str | None]
"""Condition and part of a figure."""


def check_results(results: Mapping[str, CheckResult], figures: Sequence[Figure], advice: Mapping[str, Advice]) -> None:
    """Raise InputError if a check has no results, or if its results or advice do not follow from its figures."""
    if not results:
        raise InputError("the check has no results: repeat the check")
    check_advice(figures, advice)
    derived = derived_results(figures, advice)
    for subject in (DRIVE, MAPS):
        if subject in results:  # a short drive and maps without an overlap have no figures
            derived.setdefault(subject, CheckResult.NOT_ENOUGH_DATA)
    for subject in (DRIVE, MAPS, CALIBRATION):
        if results.get(subject) is not derived.get(subject):
            stated, found = (of.get(subject, "missing") for of in (results, derived))
            raise InputError(
                f"the check contradicts itself: its result of the {subject} is '{stated}', but '{found}' follows from "
                "its figures; repeat the check"
            )


def derived_results(figures: Sequence[Figure], advice: Mapping[str, Advice]) -> dict[str, CheckResult]:
    """Return the result of each subject that has figures; the calibration only if it should be repeated."""
    results = {subject: combined(found) for subject, found in results_of_comparisons(figures).items() if found}
    if Advice.REDO in advice.values():
        results[CALIBRATION] = CheckResult.INCONSISTENT
    return results


def results_of_comparisons(figures: Sequence[Figure]) -> dict[str, tuple[CheckResult, ...]]:
    """Return the results of the comparisons of the drive and of the maps."""
    of_drive = results_of_probabilities(list(probabilities(figures)))
    return {DRIVE: of_drive, MAPS: tuple(results_of_overlaps(figures))}


def probabilities(figures: Sequence[Figure]) -> Iterator[float | None]:
    """Yield the probability of each comparison of the localiser's own runs, derived from its NEES.

    Comparisons with other estimates, which have the figure `scale`, do not decide the result. InputError if a stored
    probability differs, or if a comparison of own runs has this figure.
    """
    nees, scales = rows_of(figures, "difference_nees"), rows_of(figures, "scale")
    for key, row in rows_of(figures, "agreement").items():
        if key in scales and row.part in OWN_COMPARISONS:
            raise InputError(f"the check contradicts itself: {row.label} is not of another estimate; repeat the check")
        if key in scales:
            continue
        squares = nees.get(key)
        count = 0 if squares is None else squares.n or 0
        mean = None if squares is None else squares.mean
        least = 1 if row.condition is None else MIN_SUB_TRAJECTORIES  # one revisited place suffices
        derived = None if mean is None or count < least else probability_of_sum(mean * count, count)
        if not is_equal(row.value, derived):
            raise InputError(
                f"the check contradicts itself: {row.label} is {row.value}, but {derived} follows from its NEES; "
                "repeat the check"
            )
        yield derived


def results_of_overlaps(figures: Sequence[Figure]) -> Iterator[CheckResult]:
    """Yield the result of each two maps that overlap."""
    ratios, greys = rows_of(figures, "overlap_ratio"), rows_of(figures, "overlap_grey")
    for key, row in rows_of(figures, "overlap").items():
        ratio, grey = ratios.get(key), greys.get(key)
        if ratio is None or ratio.value is None:
            raise InputError(f"the check has no figure 'overlap_ratio' for '{row.part}': give a file of sfr check")
        grey_ratio = math.nan if grey is None or grey.value is None else grey.value
        yield result_of(row.n or 0, ratio.value, grey_ratio)


def check_advice(figures: Sequence[Figure], advice: Mapping[str, Advice]) -> None:
    """Raise InputError if the advice for an angle is missing, or contradicts the mean and the spread of its offset.

    The offsets of all runs have one sign if their spread is below the size of their mean. With a larger spread, a large
    mean permits any advice except `keep`.
    """
    spreads = rows_of(figures, "right_camera_spread")
    for key, row in rows_of(figures, "right_camera").items():
        word, spread = advice.get(row.part or ""), spreads.get(key)
        if word is None or row.value is None or spread is None or spread.value is None:
            raise InputError(
                f"the check has no advice, offset or spread for the {row.part} of the right camera: repeat the check"
            )
        if abs(row.value) < LARGE_PX:
            is_possible = word is not Advice.REDO
        elif spread.value < abs(row.value):
            is_possible = word is Advice.REDO
        else:
            is_possible = word is not Advice.KEEP
        if not is_possible:
            raise InputError(
                f"the check contradicts itself: its advice for the {row.part} of the right camera is '{word}', but the "
                f"offset is {row.value:.3g} px; repeat the check"
            )


def rows_of(figures: Sequence[Figure], figure: str) -> dict[Key, Figure]:
    """Return the rows of a figure by condition and part."""
    return {(row.condition, row.part): row for row in figures if row.figure == figure}


def is_equal(stated: float | None, derived: float | None) -> bool:
    """Return whether a stored number is the derived number; both can be undefined."""
    if stated is None or derived is None:
        return stated is derived
    return math.isclose(stated, derived, rel_tol=TOLERANCE, abs_tol=1e-300)
