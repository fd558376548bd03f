"""Starts localisation, mapping and monitor."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction

from sfr_loc_map.nodes.launch.launch_parts import all_nodes, common_arguments, file_argument
from sfr_loc_map.nodes.launch.run_nodes import NODES


def generate_launch_description() -> LaunchDescription:
    """Return the three nodes with their arguments."""
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(
                    file_argument(task), default_value="", description=f"Parameters of {task}_node; empty: defaults."
                )
                for task in NODES
            ),
            *common_arguments(),
            OpaqueFunction(function=all_nodes),
        ]
    )
