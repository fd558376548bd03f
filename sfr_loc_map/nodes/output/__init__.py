"""What the monitor publishes of a score."""
