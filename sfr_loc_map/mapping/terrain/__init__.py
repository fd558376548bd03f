"""From a cloud to what a rover needs to know of the ground: heights, slope, roughness, step, hazard."""
