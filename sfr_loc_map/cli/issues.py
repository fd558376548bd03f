"""Output of the issues of a recording or a ROS graph."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sfr_loc_map.cli.app import propose, propose_again
from sfr_loc_map.cli.output import STANDARD_OUTPUT, say, show
from sfr_loc_map.errors import FailedVerdictError
from sfr_loc_map.message_text import counted

if TYPE_CHECKING:
    from sfr_loc_map.issues import Issue
    from sfr_loc_map.tables.model import Table


@dataclass(frozen=True, slots=True)
class IssueList:
    """Issues of a subject, as `sfr info` and `sfr doctor` show them."""

    subject: str
    issues: list[Issue]

    @property
    def blocking(self) -> int:
        """Number of blocking issues."""
        return sum(issue.is_blocking for issue in self.issues)

    def propose(self, after: list[str], why: str) -> None:
        """Propose the first fix that is a command; otherwise this command if an issue is blocking, or else `after`."""
        command = next((item.command for item in self.issues if item.command), "")
        if command:
            propose(command, why="writes the sfr.yaml of the source")
        elif self.blocking:
            propose_again(why="again, after the fix")
        else:
            propose(*after, why=why)

    def show(self, json_path: str | None, facts: dict[str, Any], tables: list[Table]) -> None:
        """Print tables and issues, write the JSON; raise FailedVerdictError if an issue is blocking."""
        found = [issue.as_dict() for issue in self.issues]
        show({"subject": self.subject, **facts, "blocking": self.blocking, "issues": found}, json_path, tables)
        if json_path != STANDARD_OUTPUT:
            for issue in self.issues:
                say(f"{'BLOCKING' if issue.is_blocking else 'warning '}  {issue.where}: {issue.text}")
                say(f"          fix: {issue.fix}")
            if not self.issues:
                say(f"{self.subject}: no blocking issue")
        if self.blocking:
            raise FailedVerdictError(f"{self.subject}: {counted(self.blocking, 'blocking issue')}")
