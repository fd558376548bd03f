#!/bin/sh
# Sets up ROS and the workspace, then becomes the command, so that signals reach it.
set -e
. /opt/ros/jazzy/setup.sh
. /ros_ws/install/setup.sh
PATH="/opt/sfr/bin:$PATH"
export PATH
exec "$@"
