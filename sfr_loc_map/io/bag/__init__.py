"""Reading and writing of ROS 1 and ROS 2 bags: storage, messages, topics and frames."""
