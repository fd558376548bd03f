"""Parts of every program with a ROS node: environment, processes, messages, quality of service, services, transport."""
