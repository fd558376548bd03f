"""Measurements in a stereo pair, and its pose: pyramids, corners, patches, tracks and the pose solver."""
