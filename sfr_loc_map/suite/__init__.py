"""Suites: many sources, configurations and faults, each run in a process of its own, and what follows from them all."""
