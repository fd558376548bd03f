"""Point clouds in files and messages, and elevation grids and arrays of numbers in files.

`cloud_file` reads and writes clouds by the formats `ply`, `pcd` and `npz`, which share `fields`.
"""
