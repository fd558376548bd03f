"""Text tables of numbers, and trajectories in such tables."""
