"""Layouts of sources: one module for each, which is read, written or both, and the parts that layouts share."""
