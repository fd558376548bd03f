"""Start nodes: their arguments, their processes, and the common parts of the launch files."""
