"""Text tables of numbers, and the trajectories that are written as such tables."""
