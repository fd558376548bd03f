"""What a node says of itself on /diagnostics."""
