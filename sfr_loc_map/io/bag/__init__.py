"""ROS 1 and ROS 2 bags: storage, messages, frames and topics, read as a drive or as messages, and written."""
