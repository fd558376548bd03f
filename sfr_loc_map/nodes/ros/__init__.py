"""Basic parts of the ROS nodes: environment, quality of service, messages, services, transport statistics."""
