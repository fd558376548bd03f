"""What the three nodes share: lifecycle, endpoints, parameters, health on /diagnostics, the worker thread."""
