"""Starts one node: ros2 launch sfr_loc_map node.launch.py node:=localisation."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction

from sfr_loc_map.nodes.launch.launch_parts import common_arguments, one_node
from sfr_loc_map.nodes.launch.run_nodes import NODES


def generate_launch_description() -> LaunchDescription:
    """Return the node with its arguments."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("node", choices=list(NODES), description="Which node is started."),
            DeclareLaunchArgument("params_file", default_value="", description="Its parameters; empty: the defaults."),
            *common_arguments(),
            OpaqueFunction(function=one_node),
        ]
    )
