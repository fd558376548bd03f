"""Nodes as processes: environment, main program, start, supervision, launch files."""
