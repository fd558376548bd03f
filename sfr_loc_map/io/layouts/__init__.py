"""Layouts of sources, with one module for each layout that is read or written.

`bag_cameras`, `bag_index` and `head_pose` are parts of `bag_source`; `image_files`, `stamp_pairs` and `writer` are
parts of several layouts.
"""
