"""The parts of a live run that know no ROS."""
