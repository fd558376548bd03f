"""A ray-traced world like Mars: terrain, light, drive and sensor, with exact truth."""
