"""Start nodes: `run_nodes` as processes of `sfr run`, with `ros_arguments`; `launch_parts` in the launch files."""
