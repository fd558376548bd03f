"""`sfr doctor`: the blocking issues of a bag or a graph, or the convention mismatch that explains a disagreement."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sfr_loc_map.cli.app import app, examples, propose
from sfr_loc_map.cli.options import (
    ConfigOption,
    JsonOption,
    LenientOption,
    OverwriteOption,
    RemapOption,
    checked_namespace,
    parse_remaps,
    require_ros,
)
from sfr_loc_map.cli.output import STANDARD_OUTPUT, check_outputs, progress_bar, say, show
from sfr_loc_map.cli.verdict import not_judged
from sfr_loc_map.errors import ConfigError, FailedVerdictError, InputError

if TYPE_CHECKING:
    from sfr_loc_map.pipeline.doctor_observation import Observation

SHOWN_HYPOTHESES = 5


@app.command(
    epilog=examples(
        "sfr doctor data/",
        "sfr doctor recording.mcap --remap /cam0/image:=loc/left/image_rect",
        "sfr doctor --graph --namespace rover1 --seconds 5",
        "sfr doctor estimate.csv data/",
    ),
    hint="sfr replay SRC --start truth --out DIR    # through the nodes, scored",
)
def doctor(
    subject: Annotated[
        Path | None, typer.Argument(metavar="SRC|EST", help="Any source; or an estimated trajectory: TUM, csv, bag.")
    ] = None,
    truth: Annotated[
        Path | None, typer.Argument(metavar="TRUTH", help="With EST: trajectory, bag or data set folder.")
    ] = None,
    graph: Annotated[bool, typer.Option("--graph", help="Look at the running ROS graph.")] = False,
    namespace: Annotated[
        str,
        typer.Option("--namespace", metavar="NS", callback=checked_namespace, help="Namespace of the rover (--graph)."),
    ] = "",
    seconds: Annotated[
        float,
        typer.Option(min=0.1, max=600.0, metavar="S", help="How long messages are watched, after the first (--graph)."),
    ] = 3.0,
    config: ConfigOption = None,
    remap: RemapOption = None,
    json_path: JsonOption = None,
    overwrite: OverwriteOption = False,
    lenient: LenientOption = False,
) -> None:
    """Name the blocking issues of a source or of the running graph (--graph), each with its fix; exit 1 for any.

    With EST and TRUTH: find the convention mismatch that explains how an estimate disagrees with the truth; exit 1
    if there is one, 3 if they have no stamps in common. The disagreement is the mean error of position per distance
    travelled and of attitude in radians, re-based at many starts.
    """
    if graph != (subject is None) or (graph and truth is not None):
        raise ConfigError("nothing to examine: give SRC, or EST and TRUTH, or --graph")
    check_outputs(json_path, overwrite=overwrite, inputs=[path for path in (subject, truth) if path is not None])
    if subject is not None and truth is not None:
        _diagnose(subject, truth, json_path, lenient=lenient)
        return
    remaps = parse_remaps(remap)
    extrinsics_given = _gives_extrinsics(config)
    if subject is None:
        require_ros("doctor --graph")
        from sfr_loc_map.nodes.graph import observe_graph

        seen = observe_graph(seconds, namespace, remaps, extrinsics_given=extrinsics_given)
    else:
        seen = _observe(subject, remaps, extrinsics_given=extrinsics_given)
    _examine(seen, json_path, subject)


def _observe(source: Path, remaps: dict[str, str], *, extrinsics_given: bool) -> Observation:
    from sfr_loc_map.io.bag_files import is_bag
    from sfr_loc_map.pipeline.doctor_observation import observe_bag, observe_source

    if not source.exists():
        raise InputError(f"there is no '{source}': give a data set folder, a bag, KITTI or EuRoC, or --graph")
    if is_bag(source):
        return observe_bag(source, remaps, extrinsics_given=extrinsics_given)
    with progress_bar("pairs") as bar:
        task = bar.add_task("reading", total=None)
        return observe_source(source, extrinsics_given=extrinsics_given, progress=lambda: bar.advance(task))


def _examine(seen: Observation, json_path: str | None, source: Path | None) -> None:
    """Show the findings of a source, or of the graph; raise FailedVerdictError if there is a blocking one."""
    from sfr_loc_map.pipeline.doctor import examine

    findings = examine(seen)
    stops = sum(finding.is_blocking for finding in findings)
    if stops:
        propose("sfr", "doctor", source or "--graph", why="again, after the fix")
    elif source is not None:
        propose("sfr", "replay", source, "--out", "out", why="through the nodes; scored, if it has a truth")
    else:
        propose("sfr", "record", "drive", why="inputs and outputs of the nodes into a bag")
    content = {"subject": seen.subject, "stops": stops, "findings": [finding.as_dict() for finding in findings]}
    show(json.dumps(content, allow_nan=False) + "\n", json_path, ())
    if json_path != STANDARD_OUTPUT:
        for finding in findings:
            say(f"{'BLOCKING' if finding.is_blocking else 'warning '}  {finding.where}: {finding.text}")
            say(f"          fix: {finding.fix}")
        if not findings:
            say(f"{seen.subject}: no blocking issue")
    if stops:
        raise FailedVerdictError(f"{stops} blocking issue{'s' * (stops > 1)} on {seen.subject}")


def _gives_extrinsics(config: Path | None) -> bool:
    """Tell whether a parameter file has the pose of a stereo rig on the rover."""
    from sfr_loc_map.config import flatten_mapping, load_yaml

    values = {} if config is None else flatten_mapping(load_yaml(config))
    return any(name.endswith("quat_xyzw") and isinstance(value, list) and any(value) for name, value in values.items())


def _diagnose(estimate: Path, truth: Path, json_path: str | None, *, lenient: bool) -> None:
    """Show what explains the disagreement of estimate and truth; raise FailedVerdictError if something does."""
    from sfr_loc_map.metrics.config import ScoreConfig
    from sfr_loc_map.metrics.convention import MIN_POSES
    from sfr_loc_map.metrics.score_json import to_plain
    from sfr_loc_map.pipeline.scoring import diagnose_files
    from sfr_loc_map.report.tables import Cell, Column, Table

    diagnosis = diagnose_files(estimate, truth, ScoreConfig())
    rows = [(Cell.head("as it is"), Cell.number(diagnosis.disagreement, undefined="no stamp in common"), Cell(""))]
    rows += [
        (Cell.head(f"without: {item.mismatch}"), Cell.number(item.disagreement), Cell(item.setting))
        for item in diagnosis.hypotheses[:SHOWN_HYPOTHESES]
    ]
    columns = (Column("convention", words=True), Column("disagreement"), Column("corrected by", words=True))
    table = Table("conventions", "Estimate against truth", columns, tuple(rows))
    show(json.dumps(to_plain(diagnosis), allow_nan=False) + "\n", json_path, [table])
    if diagnosis.found is not None:
        if json_path != STANDARD_OUTPUT:
            say(diagnosis.found.sentence)
            if diagnosis.found.setting:
                say(f"sfr score ... --convention {diagnosis.found.setting} corrects it")
        raise FailedVerdictError(f"estimate and truth contradict each other by convention: {diagnosis.found.mismatch}")
    if diagnosis.disagreement is None:
        not_judged([f"'{estimate}' and '{truth}' have fewer than {MIN_POSES} stamps in common"], lenient=lenient)
    elif json_path != STANDARD_OUTPUT:
        say("no single convention mismatch explains the disagreement, if there is any")
