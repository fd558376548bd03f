"""Conventions of poses: `pose_convention` converts poses of a declared or diagnosed convention."""
