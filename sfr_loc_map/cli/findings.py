"""Output of the findings on a recording or a ROS graph."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sfr_loc_map.cli.app import propose
from sfr_loc_map.cli.output import STANDARD_OUTPUT, say, show
from sfr_loc_map.errors import FailedVerdictError

if TYPE_CHECKING:
    from sfr_loc_map.doctor.findings import Finding
    from sfr_loc_map.report.tables import Table


@dataclass(frozen=True, slots=True)
class FindingsReport:
    """Findings on a subject, as `sfr info` and `sfr doctor` show them."""

    subject: str
    findings: list[Finding]

    @property
    def stops(self) -> int:
        """Number of blocking findings."""
        return sum(finding.is_blocking for finding in self.findings)

    def propose(self, after: list[str], why: str) -> None:
        """Propose the first fix that is a command; otherwise this command if a finding is blocking, or else `after`."""
        command = next((item.command for item in self.findings if item.command), "")
        if command:
            propose(command, why="writes the sfr.yaml of the source")
        elif self.stops:
            propose("...", why="again, after the fix")
        else:
            propose(*after, why=why)

    def show(self, json_path: str | None, facts: dict[str, Any], tables: list[Table]) -> None:
        """Print tables and findings, write the JSON; raise FailedVerdictError if a finding blocks."""
        found = [finding.as_dict() for finding in self.findings]
        show({"subject": self.subject, **facts, "stops": self.stops, "findings": found}, json_path, tables)
        if json_path != STANDARD_OUTPUT:
            for finding in self.findings:
                say(f"{'BLOCKING' if finding.is_blocking else 'warning '}  {finding.where}: {finding.text}")
                say(f"          fix: {finding.fix}")
            if not self.findings:
                say(f"{self.subject}: no blocking issue")
        if self.stops:
            raise FailedVerdictError(f"{self.stops} blocking issue{'s' * (self.stops > 1)} on {self.subject}")
