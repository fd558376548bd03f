"""Keyframes and landmarks estimated together: bundle adjustment over a sliding window."""
