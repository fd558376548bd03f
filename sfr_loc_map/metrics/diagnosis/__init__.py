"""Conventions of poses: `pose_convention` converts from one, `convention_diagnosis` finds one that is not declared.

`disagreement` compares the hypotheses of a diagnosis, and `offset_search` searches for an offset of the stamps.
"""
