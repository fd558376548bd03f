"""Errors and coverage of a point cloud against what each pixel sees."""
