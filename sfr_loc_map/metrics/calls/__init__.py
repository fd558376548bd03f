"""Time and memory of the calls of a processing API."""
