"""A run over the Foxglove protocol, by its SDK (extra `[foxglove]`)."""
