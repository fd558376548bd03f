"""Terrain mapping: a point cloud from up to three stereo pairs."""
