"""What is wrong with a recording or a running graph, and what to do about it."""
