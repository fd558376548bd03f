"""`sfr doctor`: the blocking issues of the running ROS graph."""

from __future__ import annotations

from typing import Annotated

from typer import Option

from sfr_loc_map.cli.app import app, examples
from sfr_loc_map.cli.former import FormerArgument, check_doctor
from sfr_loc_map.cli.issues import IssueList
from sfr_loc_map.cli.options import (
    GraphConfigOption,
    JsonOption,
    NamespaceOption,
    OverwriteOption,
    RemapOption,
    parse_remaps,
    require_ros,
)
from sfr_loc_map.cli.output import claim_outputs
from sfr_loc_map.configuration.sections import Configuration


@app.command(epilog=examples("sfr doctor", "sfr doctor --namespace rover1 --seconds 5"))
def doctor(
    files: FormerArgument = None,
    namespace: NamespaceOption = "",
    seconds: Annotated[
        float, Option(min=0.1, max=600.0, metavar="S", help="Duration of the observation after the first message.")
    ] = 3.0,
    config: GraphConfigOption = None,
    remap: RemapOption = None,
    json_path: JsonOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """List the blocking issues of the running ROS graph, each with its fix; exit 1 if there are any."""
    check_doctor(files)
    claim_outputs(json_path, inputs=(config,), overwrite=overwrite)
    require_ros("doctor")
    from sfr_loc_map.doctor.examination import examine
    from sfr_loc_map.graph.observer import GraphObserver
    from sfr_loc_map.io.source_config import SourceConfig, with_settings

    given = SourceConfig.of(with_settings(Configuration.read(config), {}, remap=parse_remaps(remap)))
    with GraphObserver(given.topics_and_truth) as observer:
        seen = observer.observe(seconds, namespace, given)
    found = IssueList(seen.subject, examine(seen))
    found.propose(["sfr", "record", "drive"], why="records inputs and outputs to a bag")
    found.show(json_path, {}, [])
