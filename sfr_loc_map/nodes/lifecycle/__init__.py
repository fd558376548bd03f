"""Common parts of the three nodes: lifecycle, endpoints, parameters, health on /diagnostics."""
