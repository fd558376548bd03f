"""Starts localisation, mapping and monitor."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, SetEnvironmentVariable
from launch.substitutions import EnvironmentVariable, LaunchConfiguration
from launch_ros.actions import Node

from sfr_loc_map.nodes.environment import PROFILE, PROFILE_VARIABLE

PACKAGE = "sfr_loc_map"
TASKS = {
    "localisation": "Parameters of localisation_node; must give T_rb_locsb where /tf_static does not.",
    "mapping": "Parameters of mapping_node.",
    "monitor": "Parameters of monitor_node.",
}


def generate_launch_description() -> LaunchDescription:
    """Return the three nodes with their arguments."""
    config = Path(get_package_share_directory(PACKAGE)) / "config"
    arguments = [
        DeclareLaunchArgument("namespace", default_value="", description="Namespace of nodes and topics."),
        DeclareLaunchArgument("log_level", default_value="info", description="debug, info, warn or error."),
    ]
    nodes = []
    for task, description in TASKS.items():
        name = f"{task}_params_file"
        default = str(config / f"{task}.yaml")
        arguments.append(DeclareLaunchArgument(name, default_value=default, description=description))
        nodes.append(
            Node(
                package=PACKAGE,
                executable=f"{task}_node",
                namespace=LaunchConfiguration("namespace"),
                parameters=[LaunchConfiguration(name)],
                arguments=["--ros-args", "--log-level", LaunchConfiguration("log_level")],
                output="screen",
            )
        )
    profile = EnvironmentVariable(PROFILE_VARIABLE, default_value=str(PROFILE))
    return LaunchDescription([*arguments, SetEnvironmentVariable(PROFILE_VARIABLE, profile), *nodes])
