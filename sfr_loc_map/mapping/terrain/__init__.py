"""Grids of the ground for rover navigation, computed from a cloud: height, slope, roughness, step, hazard.

`cells` defines the grid of cells, `elevation` computes the heights of the cells, and `terrain_grid` computes all
layers. `shaded_relief` draws the heights.
"""
