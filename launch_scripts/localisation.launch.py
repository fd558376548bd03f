"""Starts the localisation node alone."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, SetEnvironmentVariable
from launch.substitutions import EnvironmentVariable, LaunchConfiguration
from launch_ros.actions import Node

from sfr_loc_map.nodes.environment import PROFILE, PROFILE_VARIABLE

PACKAGE = "sfr_loc_map"


def generate_launch_description() -> LaunchDescription:
    """Return the node with its arguments."""
    config = Path(get_package_share_directory(PACKAGE)) / "config"
    return LaunchDescription(
        [
            DeclareLaunchArgument("namespace", default_value="", description="Namespace of node and topics."),
            DeclareLaunchArgument(
                "params_file",
                default_value=str(config / "localisation.yaml"),
                description="Parameters; must give T_rb_locsb where /tf_static does not.",
            ),
            DeclareLaunchArgument("log_level", default_value="info", description="debug, info, warn or error."),
            SetEnvironmentVariable(PROFILE_VARIABLE, EnvironmentVariable(PROFILE_VARIABLE, default_value=str(PROFILE))),
            Node(
                package=PACKAGE,
                executable="localisation_node",
                namespace=LaunchConfiguration("namespace"),
                parameters=[LaunchConfiguration("params_file")],
                arguments=["--ros-args", "--log-level", LaunchConfiguration("log_level")],
                output="screen",
            ),
        ]
    )
