"""Point clouds in files and messages, and arrays of numbers in NPZ files.

`cloud_file` reads and writes clouds by the formats `ply`, `pcd` and `npz`, which share `fields`.
"""
