"""Fusion of the clouds of several stereo pairs: poses are registered, and points are fused along their rays."""
