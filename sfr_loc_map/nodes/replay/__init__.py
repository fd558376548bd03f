"""Replay a source through the running nodes."""
