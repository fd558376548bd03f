"""Arguments and nodes that the launch files share; needs `launch` and `launch_ros` of a full ROS 2 install."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext
from launch.actions import DeclareLaunchArgument, SetEnvironmentVariable, Shutdown
from launch.substitutions import EnvironmentVariable, LaunchConfiguration
from launch_ros.actions import Node

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.nodes.environment import PROFILE, PROFILE_VARIABLE
from sfr_loc_map.nodes.processes import TASKS

PACKAGE = "sfr_loc_map"
LEVELS = ("debug", "info", "warn", "error", "fatal")
ARGUMENTS = {
    "namespace": ("", "Namespace of nodes and topics."),
    "frame_prefix": ("", "Put before the name of each frame, as rover1/, for several rovers in one tree."),
    "autostart": ("true", "false: the nodes wait for a lifecycle manager."),
    "log_level": ("info", "debug, info, warn, error or fatal."),
    "remaps": ("", "Remappings FROM:=TO, separated by blanks, as loc/left/image_rect:=/eye/left."),
    "use_sim_time": ("false", "true: follow /clock."),
    "respawn": ("false", "true: restart a node that ends; false: all end with the first."),
}
"""Default and description of each argument."""


def common_arguments(files: dict[str, str]) -> list[Any]:
    """Return the launch arguments and environment variables of a launch file."""
    config = Path(get_package_share_directory(PACKAGE)) / "config"
    declared = dict(ARGUMENTS)
    for task, name in files.items():
        hint = "; must give T_rb_locsb where /tf_static does not" if task == "localisation" else ""
        declared[name] = str(config / f"{task}.yaml"), f"Parameters of {task}_node{hint}."
    profile = EnvironmentVariable(PROFILE_VARIABLE, default_value=str(PROFILE))
    return [
        *(DeclareLaunchArgument(n, default_value=value, description=text) for n, (value, text) in declared.items()),
        SetEnvironmentVariable(PROFILE_VARIABLE, profile),
    ]


def nodes(context: LaunchContext, files: dict[str, str]) -> list[Any]:
    """Return the nodes with the values that the launch arguments have in a context; `files` as above."""

    def value(name: str) -> str:
        return str(LaunchConfiguration(name).perform(context))

    def switch(name: str) -> bool:
        if value(name).lower() not in ("true", "false"):
            raise ConfigError(f"{name}:={value(name)}: true or false is needed")
        return value(name).lower() == "true"

    remaps = [tuple(item.split(":=")) for item in value("remaps").split()]
    if any(len(remap) != 2 or not all(remap) for remap in remaps):
        raise ConfigError(f"remaps:={value('remaps')}: FROM:=TO, separated by blanks, is needed")
    respawn, shared = switch("respawn"), {name: switch(name) for name in ("use_sim_time", "autostart")}
    if value("log_level") not in LEVELS:
        raise ConfigError(f"log_level:={value('log_level')}: one of {', '.join(LEVELS)} is needed")
    made = []
    for task in (task for task in TASKS if task in files):
        file, prefix = value(files[task]), value("frame_prefix")
        if not Path(file).is_file():
            raise ConfigError(f"{files[task]}:={file}: there is no such file; give a parameter file")
        own = {"frame_prefix": prefix} if prefix and task != "monitor" else {}  # the monitor has no frames of its own
        node = Node(
            package=PACKAGE,
            executable=f"{task}_node",
            namespace=value("namespace"),
            parameters=[file, shared | own],
            remappings=remaps,
            arguments=["--ros-args", "--log-level", value("log_level")],
            respawn=respawn,
            respawn_delay=1.0,
            on_exit=None if respawn else [Shutdown(reason=f"{task}_node has ended")],  # an empty list ends the launch
            output="screen",
        )
        made.append(node)
    return made
