"""From a cloud to what a rover needs to know of the ground: heights, slope, roughness, step, hazard.

`cells` has the grid of cells, `elevation` the heights of its cells, and `terrain_grid` all layers.
"""
