"""Starts localisation, mapping and monitor."""

from launch import LaunchDescription
from launch.actions import OpaqueFunction

from sfr_loc_map.nodes.launch_parts import common_arguments, nodes

FILES = {task: f"{task}_params_file" for task in ("localisation", "mapping", "monitor")}


def generate_launch_description() -> LaunchDescription:
    """Return the three nodes with their arguments."""
    return LaunchDescription([*common_arguments(FILES), OpaqueFunction(function=nodes, args=[FILES])])
