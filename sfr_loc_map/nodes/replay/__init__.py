"""A recorded source through the running nodes."""
