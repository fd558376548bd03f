"""Grids of the ground for rover navigation, computed from a cloud: height, slope, roughness, step, hazard.

`terrain_grid` computes all layers of the grid of `cells`: heights (`elevation`), slope and roughness (`planes`), steps
(`steps`) and hazards. `shaded_relief` draws the heights.
"""
