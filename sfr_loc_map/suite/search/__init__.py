"""Search for the worst case: which scenario within stated ranges has the least margin, and where failing begins."""
