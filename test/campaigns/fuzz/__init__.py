"""Fuzzing of every file format."""
