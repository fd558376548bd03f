"""Layouts of sources, with one module for each layout that is read or written.

`bag_rig`, `configured_drive`, `head_pose`, `stamp_pairs` and `writer` are parts of these modules.
"""
