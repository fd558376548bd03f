"""The report of the campaign: a row for each fault with its verdict, as JSON and as a table."""

from __future__ import annotations

import os
import platform
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any

from sfr_loc_map.fault_injection.fault import Fault, Outcome
from sfr_loc_map.fault_injection.settings import CampaignSettings
from sfr_loc_map.report.tables import SECOND, Cell, Column, Table

SCHEMA = "sfr-faults/1"
COLUMNS = (
    *(Column(title, words=True) for title in ("fault", "expected", "observed", "data lost")),
    Column("recovery", SECOND),
    Column("verdict", words=True),
)


class Verdict(StrEnum):
    """Verdict on a fault."""

    PASS = "pass"
    FAIL = "fail"
    NOT_RUN = "not run"


@dataclass(frozen=True, slots=True)
class Row:
    """A fault and its outcome, as reported."""

    name: str
    fault: str
    expected: str
    observed: str
    lost: str
    recover_s: float | None
    verdict: Verdict
    figures: dict[str, Any]


def row_of(fault: Fault, outcome: Outcome) -> Row:
    """Return the row of a fault that was injected."""
    said = [*outcome.observed, *(f"NOT AS EXPECTED: {text}" for text in outcome.failures)]
    verdict = Verdict.FAIL if outcome.failures else Verdict.PASS
    text = "; ".join(said)
    return Row(fault.name, fault.fault, fault.expected, text, outcome.lost, outcome.recover_s, verdict, outcome.figures)


def row_not_run(fault: Fault, reason: str) -> Row:
    """Return the row of a fault that could not be injected on this host."""
    return Row(fault.name, fault.fault, fault.expected, reason, "", None, Verdict.NOT_RUN, {})


def _row(
    fault: Fault, observed: str, lost: str, recover_s: float | None, verdict: Verdict, figures: dict[str, Any]
) -> Row:
    return Row(fault.name, fault.fault, fault.expected, observed, lost, recover_s, verdict, figures)


def report(rows: Sequence[Row], settings: CampaignSettings, seconds: float) -> dict[str, Any]:
    """Return rows, settings and host, for JSON."""
    return {
        "schema": SCHEMA,
        "settings": asdict(settings),
        "host": {
            "system": platform.platform(),
            "python": platform.python_version(),
            "processors": os.cpu_count(),
            "load_average": list(os.getloadavg()),
        },
        "seconds": seconds,
        "rows": [asdict(row) for row in rows],
    }


def outcome_table(rows: Sequence[Row]) -> Table:
    """Return rows as a table."""
    cells = tuple(
        (
            Cell.head(f"{row.name}: {row.fault}"),
            Cell(row.expected),
            Cell(row.observed),
            Cell(row.lost),
            Cell.number(row.recover_s, undefined=""),
            Cell(row.verdict),
        )
        for row in rows
    )
    return Table("faults", "", COLUMNS, cells)
