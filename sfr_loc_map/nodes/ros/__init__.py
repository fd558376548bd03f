"""What every ROS node of the suite builds on: quality of service, messages, publishers and services of the graph."""
