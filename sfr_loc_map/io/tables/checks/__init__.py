"""Checks of what a table states: its columns and units, the order of its stamps, one run of one body."""
