"""Starts the localisation node alone."""

from launch import LaunchDescription
from launch.actions import OpaqueFunction

from sfr_loc_map.nodes.launch_parts import common_arguments, nodes

FILES = {"localisation": "params_file"}


def generate_launch_description() -> LaunchDescription:
    """Return the node with its arguments."""
    return LaunchDescription([*common_arguments(FILES), OpaqueFunction(function=nodes, args=[FILES])])
