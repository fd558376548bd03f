"""Check that a stored score does not contradict itself.

Tolerance bounds and verdicts must follow from the figures and the rules. The keys and the unit of a row must be those
of a figure of the catalogue, no two rows may have the same keys, and the statistics of a row must be possible for some
values. Whether the figures follow from the inputs is not checked. `score_json` compares the hash of all values of a
file, which detects any other edit.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from msgspec.structs import asdict, fields, replace

from sfr_loc_map.metrics.conditions import is_written_condition
from sfr_loc_map.metrics.figures.catalogue import KINDS, clause_of, is_fraction, unit_of_row
from sfr_loc_map.metrics.figures.details import Details
from sfr_loc_map.metrics.figures.rows import Figure, number_text
from sfr_loc_map.metrics.figures.subjects import Subject
from sfr_loc_map.metrics.formulas import QUANTILES, mean_plus_3sigma
from sfr_loc_map.metrics.judging.judge import with_verdicts
from sfr_loc_map.metrics.judging.limited import fault_of_data_set
from sfr_loc_map.metrics.score.limits import BOUND
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.score.verdict import Verdict

TOLERANCE = 1e-9  #: Relative tolerance between a stored and a derived number.
ASCENDING = ((*QUANTILES, "max"), ("mean", "rmse", "max"), ("low95", "high95"))
"""Statistics of a row that ascend if they are given; for the mean, the absolute value is meant."""
SIZES = ("sigma", "rmse", *QUANTILES, "max")  #: Statistics that are not negative.
COUNTED = (Subject.MAP, Subject.TIMING, Subject.MEMORY, Subject.COMPLETENESS)
"""Subjects whose figures with a single number are not negative."""
MAX_COUNT = 2**63 - 1  #: Largest whole number of 64 bits.
OTHER_FRACTIONS = ("coverage", "within_period")  #: Fractions from 0 to 1 in addition to those of completeness.


class ContradictionError(ValueError):
    """A stored score contradicts itself; the message states the contradiction."""


def checked_score(score: Score) -> Score:
    """Return a stored score after its check, with the wording of this version; ContradictionError if it fails.

    The text of missing data (`incomplete`) is derived again, so that its wording is not part of the format.
    """
    for check in CHECKS:
        if (problem := check(score)) is not None:
            raise ContradictionError(problem)
    derived = with_verdicts(score)
    if (problem := fault_of_verdicts(score, derived)) is not None:
        raise ContradictionError(problem)
    return replace(score, incomplete=derived.incomplete)


def fault_of_rows(score: Score) -> str | None:
    """Return the first fault of the keys of the rows or of a mean + 3 sigma; None if there is none."""
    known: set[tuple[str | None, ...]] = set()
    for row in score.figures:
        if (problem := fault_of_keys(row)) is not None:
            return problem
        if row.keys in known:
            return f"it has the row {row.label} twice"
        known.add(row.keys)
        if row.mean is None or row.sigma is None or row.mean_plus_3sigma is None:
            continue
        expected = mean_plus_3sigma(row.mean, row.sigma)
        if abs(row.mean_plus_3sigma - expected) > TOLERANCE * max(expected, 1e-300):
            found = f"mean_plus_3sigma of {row.label} is {row.mean_plus_3sigma:.9g}"
            return f"{found}, but |mean| + 3 sigma is {expected:.9g}"
    return None


def fault_of_numbers(score: Score) -> str | None:
    """Return the first impossible number of a row; None if there is none.

    Quantiles and the maximum ascend, sizes, counts, times and sigma are not negative, fractions are at most 1, and
    |mean| <= rmse <= max. Sigma is given with mean + 3 sigma. The bounds of an interval are in order.
    """
    for row in score.figures:
        for name in (*SIZES, "value") if row.subject in COUNTED else SIZES:
            if (row.statistic(name) or 0.0) < 0.0:
                return f"{name} of {row.label} is {number_text(row.statistic(name))}: a number >= 0 is required"
        is_share = row.subject is Subject.COMPLETENESS and is_fraction(row.figure, row.part)
        if (is_share or row.figure in OTHER_FRACTIONS) and (row.value or 0.0) > 1.0 + TOLERANCE:
            return f"value of {row.label} is {number_text(row.value)}: a fraction from 0 to 1 is required"
        if row.sigma is not None and row.mean_plus_3sigma is None:
            return f"{row.label} has a sigma, but mean_plus_3sigma is absent"
        for names in ASCENDING:
            known = [(name, value) for name in names if (value := row.statistic(name)) is not None]
            for (name, value), (next_name, next_value) in pairwise(known):
                size = abs(value) if name == "mean" else value
                if size > next_value + TOLERANCE * abs(next_value):
                    found = f"{name} of {row.label} is {number_text(value)}"
                    return f"{found}, but {next_name} is {number_text(next_value)}"
    return None


def fault_of_counts(score: Score) -> str | None:
    """Return the first number of values or block size that is too small or does not fit 64 bits; None if none is."""
    for row in score.figures:
        for name in ("n", "unknown", "independent"):
            if not 0 <= (row.statistic(name) or 0) <= MAX_COUNT:
                return f"'{name}' of {row.label} is {row.statistic(name)}: a number from 0 to {MAX_COUNT} is required"
    counts = {} if score.association is None else asdict(score.association)
    for name, value in counts.items():
        if isinstance(value, int | float) and not 0 <= value <= MAX_COUNT:
            return f"'{name}' of the association is {value}: a number from 0 to {MAX_COUNT} is required"
    details = Details() if score.details is None else score.details
    sizes = [("slowest_of", plots.series.slowest_of) for plots in details.calls.values()]
    if details.trajectory is not None:
        tables = (details.trajectory.path, *details.trajectory.sub_trajectories)
        sizes += [("every", table.every) for table in tables if table is not None]
    if score.association is not None:
        sizes.append(("spacing_frames", score.association.spacing_frames))
    for name, size in sizes:
        if not 1 <= size <= MAX_COUNT:
            return f"'{name}' of its details is {size}: a number from 1 to {MAX_COUNT} is required"
    return None


def fault_of_verdicts(score: Score, derived: Score) -> str | None:
    """Return the first difference between a stored score and `derived`; None if they agree.

    `derived` is the same score with its bounds and verdicts recomputed. The texts of missing data are not compared.
    """
    if not _are_near(derived.figures, score.figures):
        return "its tolerance bounds do not follow from its sub-trajectories"
    if len(derived.verdicts) != len(score.verdicts):
        return f"it has {len(score.verdicts)} verdicts, but its figures and limits give {len(derived.verdicts)}"
    for mine, theirs in zip(score.verdicts, derived.verdicts, strict=True):
        for field in fields(Verdict):
            stored, expected = getattr(mine, field.name), getattr(theirs, field.name)
            if stored != expected and not _is_near(stored, expected):
                what = f"{field.encode_name} of the verdict on {mine.name}"
                return f"{what} is {_text(stored)}, but the figures give {_text(expected)}"
    if score.verdict != derived.verdict:
        return f"verdict is {_text(score.verdict)}, but the figures give {_text(derived.verdict)}"
    if (score.incomplete is None) != (derived.incomplete is None):
        return f"incomplete is {_text(score.incomplete)}, but the figures give {_text(derived.incomplete)}"
    return None


def fault_of_keys(row: Figure) -> str | None:
    """Return why the keys of a row are not those of a figure of the catalogue; None if they are."""
    if row.figure not in KINDS:
        return f"the row {row.label} has no figure of the catalogue"
    if row.subject is not KINDS[row.figure].subject:
        return f"subject of {row.label} is {row.subject}, but the figure is about {KINDS[row.figure].subject}"
    if row.clause != clause_of(row.figure, row.part):
        return f"clause of {row.label} is '{row.clause}', but '{clause_of(row.figure, row.part)}' defines the figure"
    unit = unit_of_row(row.figure, row.part)
    if row.unit != unit and row.figure != BOUND:  # bounds have the unit of the limited figure and are derived again
        return f"unit of {row.label} is '{row.unit}', but the figure is in '{unit}'"
    is_condition = row.condition is None or is_written_condition(row.condition)
    return None if is_condition else f"condition of {row.label} is '{row.condition}', but distance=5 is the form"


def _are_near(mine: Sequence[Figure], theirs: Sequence[Figure]) -> bool:
    """Return whether rows are equal except for rounding, because bounds depend on SciPy's special functions."""
    if len(mine) != len(theirs):
        return False
    return all(
        one is other or one == other or _is_near_everywhere(one.as_dict(), other.as_dict())
        for one, other in zip(mine, theirs, strict=True)
    )


def _is_near_everywhere(mine: dict[str, Any], theirs: dict[str, Any]) -> bool:
    return all(mine[name] == theirs[name] or _is_near(mine[name], theirs[name]) for name in mine)


def _is_near(mine: object, theirs: object) -> bool:
    if not isinstance(mine, float | int) or not isinstance(theirs, float | int):
        return False
    return abs(mine - theirs) <= TOLERANCE * max(abs(mine), abs(theirs))


def _text(value: object) -> str:
    return "null" if value is None else f"'{value}'" if isinstance(value, str) else f"{value}"


CHECKS = (fault_of_rows, fault_of_counts, fault_of_numbers, fault_of_data_set)
"""The checks of the figures and of the data set, in the order in which their faults are reported."""
