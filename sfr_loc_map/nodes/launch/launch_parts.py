"""Arguments and nodes of the launch files; requires `launch` and `launch_ros` of a full ROS 2 installation."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext
from launch.actions import DeclareLaunchArgument, SetEnvironmentVariable, Shutdown
from launch.substitutions import EnvironmentVariable, LaunchConfiguration
from launch_ros.actions import Node

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.inputs import check_regular, refusing
from sfr_loc_map.nodes.launch.run_nodes import NODES
from sfr_loc_map.ros.environment import PROFILE, PROFILE_VARIABLES, TRANSPORTS_VARIABLE

PACKAGE = "sfr_loc_map"
SWITCH = ["true", "false"]
PARAMETER = ["", *SWITCH]  #: Choices of a parameter of the nodes. Empty: the value in the parameter file.
LEVELS = ["debug", "info", "warn", "error", "fatal"]
ARGUMENTS: dict[str, tuple[str, list[str] | None, str]] = {
    "namespace": ("", None, "Namespace of nodes and topics."),
    "frame_prefix": ("", None, "Prefix of each frame name, such as rover1/, for several rovers in one tf tree."),
    "autostart": ("", PARAMETER, "false: the nodes wait for a lifecycle manager. Default: the parameter file."),
    "log_level": ("info", LEVELS, "Minimum severity of logged lines."),
    "remaps": ("", None, "Remappings FROM:=TO, separated by blanks, such as loc/left/image_rect:=/eye/left."),
    "use_sim_time": ("", PARAMETER, "true: follow /clock. Default: the parameter file."),
    "respawn": ("false", SWITCH, "true: restart a node that exits; false: shut down all nodes when one exits."),
}
"""Default, choices and description of each argument."""


def common_arguments() -> list[Any]:
    """Return the launch arguments common to all nodes, and the environment variables."""
    return [
        *(
            DeclareLaunchArgument(name, default_value=value, choices=choices, description=text)
            for name, (value, choices, text) in ARGUMENTS.items()
        ),
        *(
            SetEnvironmentVariable(name, EnvironmentVariable(name, default_value=str(PROFILE)))
            for name in PROFILE_VARIABLES
            if not os.environ.get(TRANSPORTS_VARIABLE)
        ),
    ]


def file_argument(task: str) -> str:
    """Return the name of the launch argument that gives a node its parameter file when all nodes are launched."""
    return f"{task}_params_file"


def all_nodes(context: LaunchContext) -> list[Any]:
    """Return the three nodes, with the values of the launch arguments in a context."""
    return [_node(context, task, file_argument(task)) for task in NODES]


def one_node(context: LaunchContext) -> list[Any]:
    """Return the node that the launch argument `node` names."""
    return [_node(context, _value(context, "node"), "params_file")]


def _value(context: LaunchContext, name: str) -> str:
    return str(LaunchConfiguration(name).perform(context))


def _node(context: LaunchContext, task: str, argument: str) -> Any:  # noqa: ANN401 - launch has no types
    remaps = [tuple(item.split(":=")) for item in _value(context, "remaps").split()]
    if any(len(remap) != 2 or not all(remap) for remap in remaps):
        raise ConfigError(f"remaps:={_value(context, 'remaps')}: rules FROM:=TO are required, separated by spaces")
    default = Path(get_package_share_directory(PACKAGE)) / "config" / f"{task}.yaml"
    file = Path(_value(context, argument) or default)
    with refusing(f"{argument}:={file}", "give a parameter file"):
        check_regular(file)
    # only given values are passed, because a value overrides the parameter file
    given = {name: _value(context, name) for name in ("use_sim_time", "autostart")}
    shared: dict[str, Any] = {name: value == "true" for name, value in given.items() if value}
    if (prefix := _value(context, "frame_prefix")) and task != "monitor":  # the monitor has no frames
        shared["frame_prefix"] = prefix
    respawn = _value(context, "respawn") == "true"
    return Node(
        package=PACKAGE,
        executable=f"{task}_node",
        namespace=_value(context, "namespace"),
        parameters=[str(file), shared],
        remappings=remaps,
        arguments=["--ros-args", "--log-level", _value(context, "log_level")],
        respawn=respawn,
        respawn_delay=1.0,
        on_exit=None if respawn else [Shutdown(reason=f"{task}_node has ended")],  # an empty list would end the launch
        output="screen",
    )
