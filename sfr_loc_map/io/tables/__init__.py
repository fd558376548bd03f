"""Tables of numbers as files, and trajectories in text tables: numbers, stamps, rows, columns, poses."""
