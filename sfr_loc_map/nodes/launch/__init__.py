"""Starts nodes: their environment, their processes, and the parts of launch files."""
