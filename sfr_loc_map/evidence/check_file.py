"""The JSON of `sfr check`, as a test report shows it. A contradiction shows that the file was edited."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import ClassVar

import msgspec

from sfr_loc_map.errors import InputError
from sfr_loc_map.evidence.calibration import LARGE_PX, Advice
from sfr_loc_map.evidence.check_result import (
    CALIBRATION,
    DRIVE,
    MAPS,
    CheckResult,
    count_with_enough_data,
    results_of,
    results_of_comparisons,
)
from sfr_loc_map.evidence.check_tables import check_tables
from sfr_loc_map.metrics.figures.records import Provenance
from sfr_loc_map.metrics.figures.rows import Figure
from sfr_loc_map.tables.model import Table


class CheckFile(msgspec.Struct):
    """The displayed part of the JSON of `sfr check`."""

    heading: ClassVar = "Check without ground truth"
    results: dict[str, CheckResult]
    calibration: list[str]
    figures: list[Figure]
    advice: dict[str, Advice] = {}
    pairs: dict[str, int] = {}  #: Number of checked pairs by subject; empty in files of earlier versions.
    pairs_of_source: dict[str, int] = {}
    provenance: Provenance | None = None  #: None in files of earlier versions.

    def tables(self) -> list[Table]:
        """Return the tables that the command prints; InputError if the results do not follow from the figures."""
        self._check_results()
        _check_advice(self.figures, self.advice)
        if missing := sorted({*self.pairs} - {*self.results}):
            raise InputError(f"the check has no result of the {missing[0]}: repeat the check")
        return check_tables(self.figures, self.advice)

    def _check_results(self) -> None:
        if not self.results:
            raise InputError("the check has no results: repeat the check")
        compared = {subject for subject, found in results_of_comparisons(self.figures).items() if found}
        checked = [subject for subject in (DRIVE, MAPS) if subject in self.results or subject in compared]
        derived = results_of(checked, self.figures, self.advice)
        for subject in (DRIVE, MAPS, CALIBRATION):
            stated = self.results.get(subject, "missing")
            found = derived.get(subject, "missing")
            if stated != found:
                raise InputError(
                    f"the check contradicts itself: its result of the {subject} is '{stated}', but '{found}' follows "
                    "from its figures; repeat the check"
                )

    @property
    def checked(self) -> dict[str, tuple[int, int]]:
        """For each subject with comparisons, the number of those with enough data, and the number of all."""
        results = results_of_comparisons(self.figures)
        return {
            subject: (count_with_enough_data(found), len(found))
            for subject, found in results.items()
            if subject in self.results
        }

    def result_texts(self) -> Iterator[str]:
        """Yield the result of each subject with its number of comparisons."""
        for subject, result in self.results.items():
            text = f"{subject}: {result.value}"
            if subject in self.checked:
                enough, count = self.checked[subject]
                text += f"; {enough} of {count} comparisons have enough data"
            yield f"{text}."

    def open_points(self) -> Iterator[str]:
        """Yield the results that are not consistent, and the subjects that were checked in part."""
        for subject, (enough, count) in self.checked.items():
            if enough < count:
                yield (
                    f"In the check of the {subject} without ground truth, {enough} of {count} comparisons have enough "
                    "data."
                )
        for subject, result in self.results.items():
            if result is not CheckResult.CONSISTENT:
                yield f"The result of the check of the {subject} without ground truth is '{result.value}'."
        for subject, pairs in self.pairs.items():
            if (of_source := self.pairs_of_source.get(subject, pairs)) > pairs:
                yield f"The check of the {subject} without ground truth covers {pairs} of {of_source} pairs."
        yield from (f"Calibration: {text}." for text in self.calibration)


def _check_advice(figures: Sequence[Figure], advice: Mapping[str, Advice]) -> None:
    """Raise InputError if the advice for an angle is missing, or contradicts the mean and the spread of its offset.

    The offsets of all runs have one sign if their spread is below the size of their mean. With a larger spread, a large
    mean permits any advice except `keep`.
    """
    spreads = {row.part: row.value for row in figures if row.figure == "right_camera_spread"}
    for row in figures:
        if row.figure != "right_camera":
            continue
        word = advice.get(row.part or "")
        spread = spreads.get(row.part)
        if word is None or row.value is None or spread is None:
            raise InputError(
                f"the check has no advice, offset or spread for the {row.part} of the right camera: repeat the check"
            )
        if abs(row.value) < LARGE_PX:
            is_possible = word is not Advice.REDO
        elif spread < abs(row.value):
            is_possible = word is Advice.REDO
        else:
            is_possible = word is not Advice.KEEP
        if not is_possible:
            raise InputError(
                f"the check contradicts itself: its advice for the {row.part} of the right camera is '{word}', but the "
                f"offset is {row.value:.3g} px; repeat the check"
            )
