"""Replays a data set or bag through the three nodes, which `sfr replay` starts and ends, and writes the report."""

import sys

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, SetEnvironmentVariable
from launch.substitutions import EnvironmentVariable, LaunchConfiguration, PythonExpression


def _switch(name: str) -> PythonExpression:
    """Return the switch of `sfr replay` that an argument stands for; it refuses one that is neither true nor false."""
    value = LaunchConfiguration(name)
    known = f"{{'true': '--{name}', 'false': '--no-{name}'}}"
    return PythonExpression([f"{known}.get('", value, f"'.lower(), '--{name}=", value, "')"])


def generate_launch_description() -> LaunchDescription:
    """Return the replay with its arguments."""
    option = LaunchConfiguration
    return LaunchDescription(
        [
            DeclareLaunchArgument("source", description="Data set folder, ROS 2 bag, KITTI or EuRoC sequence."),
            DeclareLaunchArgument("out", description="Folder for report, estimate, statistics and cloud."),
            DeclareLaunchArgument(
                "rate", default_value="0", description="0: wait for each result; else multiple of the recorded speed."
            ),
            DeclareLaunchArgument(
                "start_offset", default_value="0", description="Seconds of the source that are left out."
            ),
            DeclareLaunchArgument("overwrite", default_value="false", description="true: replace outputs that exist."),
            DeclareLaunchArgument("start", default_value="identity", description="First pose: identity or truth."),
            # In the domain of the other programs, so that they can watch.
            SetEnvironmentVariable("ROS_DOMAIN_ID", EnvironmentVariable("ROS_DOMAIN_ID", default_value="0")),
            ExecuteProcess(
                cmd=[
                    sys.executable,
                    "-m",
                    "sfr_loc_map",
                    "replay",
                    option("source"),
                    "--out",
                    option("out"),
                    "--rate",
                    option("rate"),
                    "--start",
                    option("start"),
                    "--start-offset",
                    option("start_offset"),
                    _switch("overwrite"),
                ],
                output="screen",
            ),
        ]
    )
