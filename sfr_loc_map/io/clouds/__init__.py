"""Point clouds in files and messages, and elevation grids and arrays of numbers in files."""
