"""`sfr doctor`: the blocking issues of the running ROS graph."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from sfr_loc_map.cli.app import app, examples, propose
from sfr_loc_map.cli.options import (
    CalibrationOption,
    ConfigOption,
    JsonOption,
    NamespaceOption,
    OverwriteOption,
    RemapOption,
    SectionsOption,
    require_ros,
    sections_of,
)
from sfr_loc_map.cli.output import STANDARD_OUTPUT, check_outputs, say, show
from sfr_loc_map.errors import ConfigError, FailedVerdictError

if TYPE_CHECKING:
    from sfr_loc_map.doctor.findings import Finding
    from sfr_loc_map.report.tables import Table


@app.command(epilog=examples("sfr doctor", "sfr doctor --namespace rover1 --seconds 5"))
def doctor(
    former: Annotated[list[Path] | None, Argument(hidden=True)] = None,
    namespace: NamespaceOption = "",
    seconds: Annotated[
        float, Option(min=0.1, max=600.0, metavar="S", help="How long messages are watched, after the first.")
    ] = 3.0,
    config: ConfigOption = None,
    calibration: CalibrationOption = None,
    settings: SectionsOption = None,
    remap: RemapOption = None,
    json_path: JsonOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Name the blocking issues of the running ROS graph, each with its fix; exit 1 for any."""
    if former:
        what = "sfr score EST TRUTH --diagnose" if len(former) > 1 else f"sfr info {former[0]}"
        raise ConfigError(f"'{former[0]}': sfr doctor examines the running graph: use {what}")
    check_outputs(json_path, inputs=(config, calibration), overwrite=overwrite)
    require_ros("doctor")
    from sfr_loc_map.doctor.examination import examine
    from sfr_loc_map.io.source_config import SourceConfig
    from sfr_loc_map.nodes.graph.observer import GraphObserver

    given = SourceConfig.of(sections_of(config, calibration, settings, remap), config)
    extrinsics_given = given.extrinsics.transform() is not None
    with GraphObserver({topic: name for name, topic in given.topics.items()}) as observer:
        seen = observer.observe(seconds, namespace, extrinsics_given=extrinsics_given)
    report = FindingsReport(seen.subject, examine(seen))
    report.propose(["sfr", "record", "drive"], why="inputs and outputs into a bag")
    report.show(json_path, {}, [])


@dataclass(frozen=True, slots=True)
class FindingsReport:
    """Findings on a subject, as `sfr info` and `sfr doctor` show them."""

    subject: str
    findings: list[Finding]

    @property
    def stops(self) -> int:
        """Number of the findings that block."""
        return sum(finding.is_blocking for finding in self.findings)

    def propose(self, after: list[str], why: str) -> None:
        """Propose the first fix that is a command, else the same command again, else `after`."""
        fix = next((item.fix.partition(";")[0] for item in self.findings if item.fix.startswith("sfr info")), "")
        if fix:
            propose(fix, why="writes the sfr.yaml of the source")
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
