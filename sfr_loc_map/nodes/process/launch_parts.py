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
from sfr_loc_map.nodes.process.environment import PROFILE, PROFILE_VARIABLE
from sfr_loc_map.nodes.process.supervisor import TASKS

PACKAGE = "sfr_loc_map"
LEVELS = ("debug", "info", "warn", "error", "fatal")
EXTRINSICS_HINT = "; must give T_rb_locsb where /tf_static does not"


def common_arguments(files: dict[str, str]) -> list[Any]:
    """Return the launch arguments and environment variables of a launch file.

    Args:
        files: Name of the argument that gives the parameter file, by task.
    """
    config = Path(get_package_share_directory(PACKAGE)) / "config"
    declared = {
        "namespace": ("", "Namespace of nodes and topics."),
        "frame_prefix": ("", "Put before the name of each frame, as rover1/, for several rovers in one tree."),
        "autostart": ("true", "false: the nodes wait for a lifecycle manager."),
        "log_level": ("info", "debug, info, warn, error or fatal."),
        "remaps": ("", "Remappings FROM:=TO, separated by blanks, as loc/left/image_rect:=/eye/left."),
        "use_sim_time": ("false", "true: follow /clock."),
        "respawn": ("false", "true: restart a node that ends; false: all end with the first."),
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
        ConfigError: If a remapping has not the form FROM:=TO, a parameter file is missing, a switch is neither true nor
            false, or the level of the log is none.
    """

    def value(name: str) -> str:
        return str(LaunchConfiguration(name).perform(context))

    remaps = [tuple(item.split(":=")) for item in value("remaps").split()]
    if any(len(remap) != 2 or not all(remap) for remap in remaps):
        raise ConfigError(f"remaps:={value('remaps')}: FROM:=TO, separated by blanks, is needed")
    respawn = _switch("respawn", value("respawn"))
    shared = {"use_sim_time": _switch("use_sim_time", value("use_sim_time"))}
    shared |= {"autostart": _switch("autostart", value("autostart"))}
    if value("log_level") not in LEVELS:
        raise ConfigError(f"log_level:={value('log_level')}: one of {', '.join(LEVELS)} is needed")
    return [
        Node(
            package=PACKAGE,
            executable=f"{task}_node",
            namespace=value("namespace"),
            parameters=[_file(files[task], value(files[task])), shared | _prefix(task, value("frame_prefix"))],
            remappings=remaps,
            arguments=["--ros-args", "--log-level", value("log_level")],
            respawn=respawn,
            respawn_delay=1.0,
            on_exit=[] if respawn else [Shutdown(reason=f"{task}_node has ended")],
            output="screen",
        )
        for task in TASKS
        if task in files
    ]


def _prefix(task: str, prefix: str) -> dict[str, str]:
    """Return the parameter of frame names; the monitor has no frames of its own."""
    return {"frame_prefix": prefix} if prefix and task != "monitor" else {}


def _switch(name: str, text: str) -> bool:
    if text.lower() not in ("true", "false"):
        raise ConfigError(f"{name}:={text}: true or false is needed")
    return text.lower() == "true"


def _file(name: str, path: str) -> str:
    if not Path(path).is_file():
        raise ConfigError(f"{name}:={path}: there is no such file; give a parameter file")
    return path
