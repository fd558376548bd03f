"""Grids of the ground for rover navigation, computed from a cloud: height, slope, roughness, step, hazard.

Modules in the order of the calls:

    terrain_grid          all layers of a grid, and hazards
      cells               the grid of square cells
      elevation           height of each cell, with its standard deviation
      planes              slope and roughness: planes fitted to the heights
      steps               steps relative to these planes
    shaded_relief         image of the heights
"""
