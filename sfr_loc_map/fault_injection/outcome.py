"""A fault of the campaign, its outcome, and the table of both."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sfr_loc_map.tables.numbers import SECOND
from sfr_loc_map.tables.table import Cell, Column, Table

if TYPE_CHECKING:
    from sfr_loc_map.fault_injection.harness import Harness

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


@dataclass(slots=True)
class Outcome:
    """What was observed of a fault; filled step by step.

    Attributes:
        observed: What happened, in words.
        lost: What data was lost, in words.
        recover_s: From the end of the fault (or the restart) to the first valid result, seconds; None where nothing
            had to recover.
        failures: What was not as expected; empty for a pass.
        figures: Numbers for the JSON report.
    """

    observed: list[str] = field(default_factory=list)
    lost: str = "nothing"
    recover_s: float | None = None
    failures: list[str] = field(default_factory=list)
    figures: dict[str, Any] = field(default_factory=dict)

    def expect(self, condition: object, text: str) -> None:
        """Record a failure with this text unless the condition holds."""
        if not condition:
            self.failures.append(text)

    def recovered(self, seconds: float, limit_s: float, what: str) -> None:
        """Record how long the recovery took, and compare it with its limit."""
        self.recover_s = max(self.recover_s or 0.0, seconds)
        self.expect(seconds <= limit_s, f"{what} took {seconds:.1f} s, the limit is {limit_s:g} s")


@dataclass(frozen=True, slots=True)
class CampaignSettings:
    """Settings of the campaign.

    Attributes:
        stop_s: How long a process is stopped by SIGSTOP, seconds.
        restart_limit_s: From the start of a killed node to its first result, seconds.
        soak_minutes: Length of the soak; 0 leaves it out.
        slope_limit: Largest growth of memory in the soak, MB/h.
        patience_s: How long a result is awaited at most, seconds.
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
        fault: What is injected.
        expected: Expected outcome.
        run: Injects it by means of the harness and fills the outcome.
        arguments: ROS arguments of nodes beside the common ones, by node; faults with the same share their processes.
        own_mounts: Whether it mounts file systems and therefore runs in a mount namespace (Linux, root).
        prepare: Called with the folder of logs and saved files before the nodes start.
    """

    name: str
    fault: str
    expected: str
    run: Callable[[Harness, Outcome], None]
    arguments: Mapping[str, Sequence[str]] = field(default_factory=dict)
    own_mounts: bool = False
    prepare: Callable[[Path], None] | None = None


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
