"""True poses: where they are read from, what they are of, and which of them can be true."""
