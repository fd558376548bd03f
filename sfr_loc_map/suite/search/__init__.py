"""Search for the worst case: the scenario with the least margin within given ranges, and where failures begin."""
