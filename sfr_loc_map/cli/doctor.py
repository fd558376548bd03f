"""`sfr doctor`: what would stop us on a bag or a graph, or which mistake of convention makes an estimate disagree."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sfr_loc_map.cli.common import ConfigOption, RemapOption, parse_remaps, require_ros
from sfr_loc_map.errors import ConfigError, FailedVerdictError, InputError

if TYPE_CHECKING:
    from sfr_loc_map.pipeline.doctor.observation import Observation


def doctor(
    subject: Annotated[
        Path | None, typer.Argument(metavar="[BAG|EST]", help="Bag; or an estimated trajectory: TUM, csv, bag.")
    ] = None,
    truth: Annotated[
        Path | None, typer.Argument(metavar="[TRUTH]", help="With EST: trajectory, bag or data set folder.")
    ] = None,
    graph: Annotated[bool, typer.Option("--graph", help="Look at the running ROS graph.")] = False,
    namespace: Annotated[str, typer.Option("--namespace", help="Namespace of the rover (--graph).")] = "",
    seconds: Annotated[float, typer.Option(min=0.1, max=600.0, help="How long messages are watched (--graph).")] = 3.0,
    config: ConfigOption = None,
    remap: RemapOption = None,
    json_path: Annotated[
        str | None, typer.Option("--json", metavar="F", help="Write what was found as JSON; - for standard output.")
    ] = None,
) -> None:
    """Name what would stop us on a bag or on the running graph (--graph), each with its cure; exit 1 if any.

    With EST and TRUTH: find the mistake of convention that explains how an estimate disagrees with the truth. The
    disagreement is the mean error of position over the way and of attitude in radians, re-based at many starts.
    """
    if graph != (subject is None) or (graph and truth is not None):
        raise ConfigError("what shall be looked at? give BAG, or EST and TRUTH, or --graph")
    if subject is not None and truth is not None:
        _conventions(subject, truth, json_path)
        return
    remaps = parse_remaps(remap)
    place = _gives_place(config)
    if graph:
        require_ros("doctor --graph")
        from sfr_loc_map.nodes.tools.graph_observation import observe_graph

        _examine(observe_graph(seconds, namespace, remaps, place_given=place), json_path)
    elif subject is not None:
        from sfr_loc_map.pipeline.doctor.bag import observe_bag

        if not subject.exists():
            raise InputError(f"there is no '{subject}': give a bag, or --graph")
        _examine(observe_bag(subject, remaps, place_given=place), json_path)


def _examine(seen: Observation, json_path: str | None) -> None:
    from sfr_loc_map.pipeline.doctor.checks import examine

    findings = examine(seen)
    stops = sum(finding.stops for finding in findings)
    _write(
        json_path, {"subject": seen.subject, "stops": stops, "findings": [finding.as_dict() for finding in findings]}
    )
    if json_path != "-":
        for finding in findings:
            typer.echo(f"{'STOPS' if finding.stops else 'warns'}  {finding.where}: {finding.text}")
            typer.echo(f"       cure: {finding.cure}")
        if not findings:
            typer.echo(f"{seen.subject}: nothing would stop us")
    if stops:
        raise FailedVerdictError(f"{stops} thing{'s' * (stops > 1)} would stop us on {seen.subject}")


def _gives_place(config: Path | None) -> bool:
    """Tell whether a parameter file says where the stereo bench is."""
    from sfr_loc_map.config import load_yaml

    if config is None:
        return False

    def quats(block: Any) -> list[Any]:  # noqa: ANN401 - anything that YAML holds
        if not isinstance(block, dict):
            return []
        own = [value for name, value in block.items() if str(name).endswith("quat_xyzw")]
        return own + [value for inner in block.values() for value in quats(inner)]

    return any(isinstance(value, list) and any(value) for value in quats(load_yaml(config)))


def _conventions(estimate: Path, truth: Path, json_path: str | None) -> None:
    from dataclasses import asdict

    from sfr_loc_map.metrics.config import ScoreConfig
    from sfr_loc_map.pipeline.scoring import diagnose_files

    diagnosis = diagnose_files(estimate, truth, ScoreConfig())
    _write(json_path, asdict(diagnosis))
    if json_path == "-":
        return
    before = diagnosis.disagreement
    typer.echo("no stamp in common" if before is None else f"disagreement as it stands: {before:.4g}")
    for item in diagnosis.suspicions[:5]:
        typer.echo(f"  {item.disagreement:.4g} without: {item.mistake}")
    if diagnosis.found is not None:
        typer.echo(diagnosis.found.sentence)
    else:
        typer.echo("no single mistake of convention explains what disagreement there is")


def _write(json_path: str | None, content: dict[str, Any]) -> None:
    from sfr_loc_map.io.atomic import atomic_path

    text = json.dumps(content, allow_nan=False) + "\n"
    if json_path == "-":
        sys.stdout.write(text)
    elif json_path is not None:
        with atomic_path(Path(json_path)) as temporary:
            temporary.write_text(text, encoding="utf-8")
