"""Conventions of poses: `pose_convention` converts from one, `convention_diagnosis` finds one that is not declared."""
