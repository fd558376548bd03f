"""From recordings of all kinds to a verdict."""
