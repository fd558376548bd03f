"""Replay of a source through the running nodes."""
