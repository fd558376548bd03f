"""Uncertainty of poses and steps: named error sources, their sum along the path, and the covariances."""
