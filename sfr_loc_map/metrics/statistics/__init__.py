"""Statistics that do not depend on how values came in, and quantiles."""
