#!/bin/sh
# Set up ROS and the workspace, then replace the shell by the command, so that the command receives signals.
set -e
. /opt/ros/jazzy/setup.sh
. /ros_ws/install/setup.sh
PATH="/opt/sfr/bin:$PATH"
export PATH
exec "$@"
