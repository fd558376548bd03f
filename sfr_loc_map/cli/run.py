"""`sfr run`: run the nodes without `ros2 launch`."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Literal

from typer import Argument, Context, Option

from sfr_loc_map.cli.app import app, examples, propose
from sfr_loc_map.cli.live_option import LiveOption, PortOption, live_page
from sfr_loc_map.cli.options import GraphConfigOption, NamespaceOption, RosRemapOption, require_ros
from sfr_loc_map.cli.output import say
from sfr_loc_map.live.config import DEFAULT_PORT


@app.command(
    context_settings={"ignore_unknown_options": True},  # unknown options are passed on to ROS
    epilog=examples(
        "sfr run",
        "sfr run localisation --params-file config/localisation.yaml --namespace rover1",
        "sfr run all -r loc/left/image_rect:=/eye/left --respawn",
    ),
)
def run(
    context: Context,
    names: Annotated[
        list[str] | None,
        Argument(
            metavar="[all|localisation|mapping|monitor]... [--ros-args ...]",
            help="Nodes; default: all. Each node receives the arguments after --ros-args (parameter of one node: "
            "-p localisation_node:NAME:=VALUE).",
        ),
    ] = None,
    params_file: Annotated[
        list[Path] | None, Option(metavar="P.yaml", help="ROS parameter file of the nodes; repeatable.")
    ] = None,
    config: GraphConfigOption = None,
    namespace: NamespaceOption = "",
    rules: RosRemapOption = None,
    log_level: Annotated[
        Literal["debug", "info", "warn", "error"], Option(help="Minimum severity of displayed messages.")
    ] = "info",
    respawn: Annotated[
        bool, Option("--respawn", help="Restart crashed nodes; by default a crash stops all nodes.")
    ] = False,
    live: LiveOption = False,
    live_port: PortOption = DEFAULT_PORT,
) -> None:
    """Run each node in its own process until Ctrl-C, SIGTERM or SIGHUP; exit 2 if a node ends earlier."""
    require_ros("run")
    propose("sfr doctor", why="checks the inputs of the running nodes")
    from sfr_loc_map.live.page_process import shown_on
    from sfr_loc_map.nodes.launch.ros_arguments import ros_arguments, split_ros_arguments, topic_rules
    from sfr_loc_map.nodes.launch.run_nodes import node_names, run_nodes

    words, more = split_ros_arguments(names or ())
    nodes = node_names(words)
    with TemporaryDirectory(prefix="sfr-run-") as scratch:
        arguments = ros_arguments(
            more,
            config,
            Path(scratch) / "parameters.yaml",
            nodes=nodes,
            parameter_files=params_file or (),
            remaps=rules or (),
            namespace=namespace,
            log_level=log_level,
        )
        with live_page(context, live, live_port, namespace, topic_rules(arguments)) as page, shown_on(page):
            run_nodes(nodes, arguments, lambda text: say(f"sfr run: {text}", err=True), respawn=respawn)
