"""Layouts of sources: one module for each, which is read, written or both, and their parts."""
