"""The table of `sfr score --diagnose`: the disagreement without each convention mismatch."""

from __future__ import annotations

from sfr_loc_map.metrics.diagnosis.convention_diagnosis import Diagnosis
from sfr_loc_map.tables.model import Cell, Column, Table

MAX_HYPOTHESES = 5  #: Number of shown mismatches, those with the smallest remaining disagreement.


def diagnosis_table(diagnosis: Diagnosis) -> Table:
    """Return the disagreement of the estimate as it is, and after the correction of each mismatch."""
    rows = [(Cell.head("as it is"), Cell.number(diagnosis.disagreement, undefined="no stamp in common"), Cell(""))]
    rows += [
        (Cell.head(f"without: {item.mismatch}"), Cell.number(item.disagreement), Cell(item.setting))
        for item in diagnosis.hypotheses[:MAX_HYPOTHESES]
    ]
    columns = (Column("convention", words=True), Column("disagreement"), Column("corrected by", words=True))
    return Table("conventions", "Estimate against truth", columns, tuple(rows))
