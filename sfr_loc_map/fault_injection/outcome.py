"""What a fault of the campaign is, what became of it, and both as a table."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sfr_loc_map.tables.numbers import SECOND
from sfr_loc_map.tables.table import Cell, Column, Table

if TYPE_CHECKING:
    from sfr_loc_map.fault_injection.harness import Bench

SCHEMA = "sfr-faults/1"
PASS, FAIL, NOT_RUN = "pass", "fail", "not run"
COLUMNS = (
    *(Column(title, words=True) for title in ("fault", "expected", "observed", "data lost")),
    Column("recovery", SECOND),
    Column("verdict", words=True),
)


@dataclass(slots=True)
class Outcome:
    """What was seen of a fault; filled step by step.

    Attributes:
        observed: What happened, in words.
        lost: What data was lost, in words.
        recover_s: From the end of the fault (or the restart) to the first good result, seconds; None where nothing
            had to recover.
        failures: What was not as expected; empty for a pass.
        figures: Numbers behind the words.
    """

    observed: list[str] = field(default_factory=list)
    lost: str = "nothing"
    recover_s: float | None = None
    failures: list[str] = field(default_factory=list)
    figures: dict[str, Any] = field(default_factory=dict)

    def expect(self, condition: object, text: str) -> None:
        """Note what should hold; the text says what was found where it does not."""
        if not condition:
            self.failures.append(text)

    def recovered(self, seconds: float, limit_s: float, what: str) -> None:
        """Note how long the recovery took, and hold it against its limit."""
        self.recover_s = max(self.recover_s or 0.0, seconds)
        self.expect(seconds <= limit_s, f"{what} took {seconds:.1f} s, the limit is {limit_s:g} s")


@dataclass(frozen=True, slots=True)
class CampaignSettings:
    """How hard the campaign is.

    Attributes:
        stop_s: How long a process is stopped by SIGSTOP, seconds.
        restart_limit_s: From the start of a killed node to its first result, seconds.
        soak_minutes: Length of the soak; 0 leaves it out.
        slope_limit: Largest growth of memory in the soak, MB an hour.
        patience_s: How long a result is waited for at most, seconds.
    """

    stop_s: float = 10.0
    restart_limit_s: float = 3.0
    soak_minutes: float = 1.0
    slope_limit: float = 1.0
    patience_s: float = 30.0


@dataclass(frozen=True, slots=True)
class Fault:
    """One row of the campaign.

    Attributes:
        name: Its name on the command line.
        fault: What is done.
        expected: What should become of it.
        run: Does it with the bench.
        arguments: ROS arguments of nodes beside the usual ones, by node; rows with the same share their processes.
        own_mounts: Whether it needs file systems of its own: it then runs in a mount namespace (Linux, root).
        prepare: Done to the folder of logs and saved files before the nodes start.
    """

    name: str
    fault: str
    expected: str
    run: Callable[[Bench, Outcome], None]
    arguments: Mapping[str, Sequence[str]] = field(default_factory=dict)
    own_mounts: bool = False
    prepare: Callable[[Path], None] | None = None


@dataclass(frozen=True, slots=True)
class Row:
    """A fault and its outcome, as written."""

    name: str
    fault: str
    expected: str
    observed: str
    lost: str
    recover_s: float | None
    verdict: str
    figures: dict[str, Any]


def row_of(fault: Fault, outcome: Outcome) -> Row:
    """Return the row of a fault that was run."""
    said = [*outcome.observed, *(f"NOT AS EXPECTED: {text}" for text in outcome.failures)]
    verdict = FAIL if outcome.failures else PASS
    return _row(fault, "; ".join(said), outcome.lost, outcome.recover_s, verdict, outcome.figures)


def row_not_run(fault: Fault, reason: str) -> Row:
    """Return the row of a fault that could not be run here."""
    return _row(fault, reason, "", None, NOT_RUN, {})


def _row(fault: Fault, observed: str, lost: str, recover_s: float | None, verdict: str, figures: dict[str, Any]) -> Row:
    return Row(fault.name, fault.fault, fault.expected, observed, lost, recover_s, verdict, figures)


def report(rows: Sequence[Row], settings: CampaignSettings, seconds: float) -> dict[str, Any]:
    """Return rows with what they were made with, for JSON."""
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
