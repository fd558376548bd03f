"""Point clouds, elevation grids and arrays of numbers as files."""
