"""The table of `sfr score --diagnose`: the disagreement as delivered, and after the correction of each mismatch."""

from __future__ import annotations

from sfr_loc_map.metrics.conventions.convention_diagnosis import Diagnosis, Hypothesis
from sfr_loc_map.tables.model import Cell, Column, Row, Table

MAX_HYPOTHESES = 5  #: Number of shown mismatches, those with the smallest remaining disagreement.


def diagnosis_table(diagnosis: Diagnosis) -> Table:
    """Return the disagreement of the estimate as delivered, and after the correction of each mismatch.

    The mismatch that explains the disagreement is always shown.
    """
    shown = diagnosis.hypotheses[:MAX_HYPOTHESES]
    if diagnosis.found is not None and diagnosis.found not in shown:
        shown = (*shown, diagnosis.found)
    before = Cell.number(diagnosis.disagreement, undefined="too few common stamps")
    rows: list[Row] = [(Cell.head("as it is"), before, Cell(""), Cell(""), Cell(""))]
    rows += [_row(item, is_found=item == diagnosis.found) for item in shown]
    columns = (
        Column("convention", words=True),
        Column("disagreement"),
        Column("fitted", words=True),
        Column("explains", words=True),
        Column("corrected by", words=True),
    )
    note = (
        "Disagreement: mean over sub-trajectories of an eighth of the poses. For each, it is the norm of two numbers: "
        "the position error divided by the path length, and the attitude error in radians. Fitted: the correction has "
        "numbers that were fitted to the truth. Explains: little disagreement remains, and far less than with simpler "
        "explanations. "
        f"{len(shown)} of {len(diagnosis.hypotheses)} hypotheses are shown."
    )
    return Table("conventions", "Estimate against truth", columns, tuple(rows), note)


def _row(item: Hypothesis, *, is_found: bool) -> Row:
    return (
        Cell.head(f"without: {item.mismatch}"),
        Cell.number(item.disagreement),
        Cell("yes" if item.fitted else "no"),
        Cell("yes" if is_found else "no"),
        Cell(item.setting),
    )
