"""`sfr run`: the nodes, without `ros2 launch`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sfr_loc_map.cli import completion
from sfr_loc_map.cli.app import app, examples
from sfr_loc_map.cli.common import checked_namespace, require_ros
from sfr_loc_map.cli.live import LiveOption, LivePortOption, live_beside
from sfr_loc_map.cli.output import say
from sfr_loc_map.errors import InputError

ROS_ARGS = "--ros-args"


LogLevelOption = Annotated[
    str,
    typer.Option(
        "--log-level",
        metavar="debug|info|warn|error",
        autocompletion=completion.words("debug", "info", "warn", "error"),
        help="Least severe messages shown.",
    ),
]


@app.command(
    context_settings={"ignore_unknown_options": True},  # what it does not know is passed on to ROS
    epilog=examples(
        "sfr run",
        "sfr run localisation --params-file config/localisation.yaml --namespace rover1",
        "sfr run all -r loc/left/image_rect:=/eye/left --respawn",
    ),
)
def run(
    words: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[all|localisation|mapping|monitor]... [--ros-args ...]",
            autocompletion=completion.words("all", "localisation", "mapping", "monitor"),
            help="Nodes, all by default; what follows --ros-args goes to each of them (a parameter of one: "
            "-p localisation_node:NAME:=VALUE).",
        ),
    ] = None,
    params_file: Annotated[
        list[Path] | None,
        typer.Option(
            "--params-file", metavar="P.yaml", help="ROS parameter file, for all nodes named in it; repeatable."
        ),
    ] = None,
    namespace: Annotated[
        str,
        typer.Option("--namespace", metavar="NS", callback=checked_namespace, help="Namespace of nodes and topics."),
    ] = "",
    remap: Annotated[
        list[str] | None, typer.Option("-r", metavar="FROM:=TO", help="Remapping as of ROS; repeatable.")
    ] = None,
    log_level: LogLevelOption = "info",
    respawn: Annotated[
        bool, typer.Option("--respawn", help="Restart a node that crashes; by default the others are ended.")
    ] = False,
    live: LiveOption = False,
    live_port: LivePortOption = 8080,
) -> None:
    """Run the nodes, one process each, until Ctrl-C or SIGTERM; exit 2 if one ends before."""
    require_ros("run")
    from sfr_loc_map.nodes.process.supervisor import node_names, run_nodes

    given = list(words or ())
    cut = given.index(ROS_ARGS) if ROS_ARGS in given else len(given)
    arguments = [ROS_ARGS, "--log-level", log_level]
    for path in params_file or ():
        if not path.is_file():
            raise InputError(f"there is no parameter file '{path}': give a file, as those in config/")
        arguments += ["--params-file", str(path)]
    for item in [f"__ns:=/{namespace.strip('/')}"] * bool(namespace) + (remap or []):
        arguments += ["-r", item]
    nodes = node_names(given[:cut])
    with live_beside(live, live_port, namespace):
        run_nodes(
            nodes, [*arguments, *given[cut + 1 :]], lambda text: say(f"sfr run: {text}", err=True), respawn=respawn
        )
