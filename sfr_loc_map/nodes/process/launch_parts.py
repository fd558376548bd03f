"""Arguments and nodes that the launch files share; needs `launch` and `launch_ros` of a full ROS 2 install."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext
from launch.actions import DeclareLaunchArgument, SetEnvironmentVariable
from launch.substitutions import EnvironmentVariable, LaunchConfiguration
from launch_ros.actions import Node

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.nodes.process.environment import PROFILE, PROFILE_VARIABLE
from sfr_loc_map.nodes.process.supervisor import TASKS

PACKAGE = "sfr_loc_map"
EXTRINSICS_HINT = "; must give T_rb_locsb where /tf_static does not"


def common_arguments(files: dict[str, str]) -> list[Any]:
    """Return the launch arguments and environment variables of a launch file.

    Args:
        files: Name of the argument that gives the parameter file, by task.
    """
    config = Path(get_package_share_directory(PACKAGE)) / "config"
    declared = {
        "namespace": ("", "Namespace of nodes and topics."),
        "log_level": ("info", "debug, info, warn or error."),
        "remaps": ("", "Remappings FROM:=TO, separated by blanks, as loc/left/image_rect:=/eye/left."),
        "use_sim_time": ("false", "true: follow /clock."),
        "respawn": ("false", "true: restart a node that ends."),
    }
    for task, name in files.items():
        declared[name] = (
            str(config / f"{task}.yaml"),
            f"Parameters of {task}_node{EXTRINSICS_HINT if task == 'localisation' else ''}.",
        )
    profile = EnvironmentVariable(PROFILE_VARIABLE, default_value=str(PROFILE))
    return [
        *(DeclareLaunchArgument(n, default_value=value, description=text) for n, (value, text) in declared.items()),
        SetEnvironmentVariable(PROFILE_VARIABLE, profile),
    ]


def nodes(context: LaunchContext, files: dict[str, str]) -> list[Any]:
    """Return the nodes with the values that the launch arguments have.

    Args:
        context: Holds these values.
        files: Name of the argument that gives the parameter file, by task.

    Raises:
        ConfigError: If a remapping has not the form FROM:=TO.
    """

    def value(name: str) -> str:
        return str(LaunchConfiguration(name).perform(context))

    remaps = [tuple(item.split(":=")) for item in value("remaps").split()]
    if any(len(remap) != 2 or not all(remap) for remap in remaps):
        raise ConfigError(f"remaps:={value('remaps')}: FROM:=TO, separated by blanks, is needed")
    sim_time = [{"use_sim_time": True}] if value("use_sim_time").lower() == "true" else []
    return [
        Node(
            package=PACKAGE,
            executable=f"{task}_node",
            namespace=value("namespace"),
            parameters=[value(files[task]), *sim_time],
            remappings=remaps,
            arguments=["--ros-args", "--log-level", value("log_level")],
            respawn=value("respawn").lower() == "true",
            respawn_delay=1.0,
            output="screen",
        )
        for task in TASKS
        if task in files
    ]
