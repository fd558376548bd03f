"""Basic parts of every program with a ROS node: environment, messages, quality of service, services, transport."""
