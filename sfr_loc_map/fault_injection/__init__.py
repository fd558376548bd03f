"""Injected faults: what the node processes survive over real DDS, and which rates they carry."""
