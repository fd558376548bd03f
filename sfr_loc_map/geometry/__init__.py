"""Rotations, transforms, trajectories, rigs and clouds: the types that the other layers meet in."""
