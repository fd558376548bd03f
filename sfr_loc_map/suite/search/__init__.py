"""Search for the worst case: the scenario with the smallest margin within given ranges, and where failures begin."""
