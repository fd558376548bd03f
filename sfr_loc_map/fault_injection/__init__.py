"""Faults done on purpose to the node processes over real DDS, and what became of it."""
