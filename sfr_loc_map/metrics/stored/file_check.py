"""Check that a stored score does not contradict itself.

Rows must have the keys of a figure of the catalogue. Mean + 3 sigma must follow from mean and sigma, the figures from
the raw values (`raw_values`), and tolerance bounds and verdicts from figures and rules. `score_json` also compares the
hash of the values of a file.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from sfr_loc_map.metrics.config import is_written_condition
from sfr_loc_map.metrics.formulas import mean_plus_3sigma
from sfr_loc_map.metrics.judging.judge import with_verdicts
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.score.verdict import Verdict
from sfr_loc_map.metrics.stored.raw_values import fault_of_raw_values
from sfr_loc_map.metrics.table.catalogue import KINDS, clause_of
from sfr_loc_map.metrics.table.rows import Figure

ROUNDING = 1e-9  #: Relative tolerance between a stored and a derived number.


def fault_of_file(score: Score) -> str | None:
    """Return the first contradiction between a stored score and its figures and rules; None if there is none."""
    for row in score.figures:
        if (problem := fault_of_keys(row)) is not None:
            return problem
        if row.mean is None or row.sigma is None or row.mean_plus_3sigma is None:
            continue
        expected = mean_plus_3sigma(row.mean, row.sigma)
        if abs(row.mean_plus_3sigma - expected) > ROUNDING * max(expected, 1e-300):
            return (
                f"mean_plus_3sigma of {row.label} is {row.mean_plus_3sigma:.9g}, but |mean| + 3 sigma is {expected:.9g}"
            )
    if (problem := fault_of_raw_values(score)) is not None:
        return problem
    again = with_verdicts(score)
    if not _are_near(again.figures, score.figures):
        return "its tolerance bounds do not follow from its sub-trajectories"
    if len(again.verdicts) != len(score.verdicts):
        return f"it has {len(score.verdicts)} verdicts, but its figures and limits give {len(again.verdicts)}"
    for stored, derived in zip(score.verdicts, again.verdicts, strict=True):
        for field in Verdict.__struct_fields__:
            mine, theirs = getattr(stored, field), getattr(derived, field)
            if mine != theirs and not _is_near(mine, theirs):
                what = f"{json_name(field)} of the verdict on {stored.name}"
                return f"{what} is {_text(mine)}, but the figures give {_text(theirs)}"
    for field in ("verdict", "incomplete"):
        mine, theirs = getattr(score, field), getattr(again, field)
        if mine != theirs:
            return f"{field} is {_text(mine)}, but the figures give {_text(theirs)}"
    return None


def fault_of_keys(row: Figure) -> str | None:
    """Return why the keys of a row are not those of a figure of the catalogue; None if they are."""
    if row.figure not in KINDS:
        return f"the row {row.label} has no figure of the catalogue"
    if row.subject is not KINDS[row.figure].subject:
        return f"subject of {row.label} is {row.subject}, but the figure is about {KINDS[row.figure].subject}"
    if row.clause != clause_of(row.figure, row.part):
        return f"clause of {row.label} is '{row.clause}', but '{clause_of(row.figure, row.part)}' defines the figure"
    is_condition = row.condition is None or is_written_condition(row.condition)
    return None if is_condition else f"condition of {row.label} is '{row.condition}', but distance=5 is the form"


def json_name(field: str) -> str:
    """Return the JSON name of a field of a verdict."""
    return "verdict" if field == "state" else field


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
    return abs(mine - theirs) <= ROUNDING * max(abs(mine), abs(theirs))


def _text(value: object) -> str:
    return "null" if value is None else f"'{value}'" if isinstance(value, str) else f"{value}"
