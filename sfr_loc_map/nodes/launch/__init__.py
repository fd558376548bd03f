"""Start of the nodes: `run_nodes` and `ros_arguments` serve `sfr run`, and `launch_parts` serves the launch files."""
